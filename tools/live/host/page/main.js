// The page: what is shown, what was asked, and the order in which both happen.

import { firstPanels } from "./axes.js";
import { Net } from "./net.js";
import { TimePanel, PhasePanel, MOST_CURVES, MOST_NAME, deliver, el } from "./panels.js";
import { Runs } from "./runs.js";
import { Side } from "./side.js";

const WINDOWS = [0.5, 1, 2, 5, 10, 20, 60];
const by = (id) => document.getElementById(id);

class Page {
  constructor() {
    this.variables = new Map(); this.panels = []; this.active = null;
    this.window_s = 5; this.span = null; this.instant = null; this.about = null;
    this.paused = false; this.newest_s = 0; this.frames = 0;
    for (const s of WINDOWS) by("window").append(new Option(`${s} s`, s, s === 5, s === 5));
    by("window").onchange = (event) => { this.window_s = +event.target.value; this.span = null; this.again(); this.kept(); };
    by("add-panel").onclick = () => { this.activate(this.put(new TimePanel(this, []))); this.kept(); };
    by("add-phase").onclick = () => { this.activate(this.put(new PhasePanel(this, []))); this.kept(); };
    by("pause").onclick = () => this.pause(!this.paused);
    by("save").onclick = () => this.save();
    by("load").onclick = () => this.load();
    document.addEventListener("keydown", (event) => {
      if (event.key === " " && event.target === document.body) { event.preventDefault(); this.pause(!this.paused); }
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.panels.forEach((panel) => panel.build()));
    addEventListener("resize", () => { this.side.painted = false; this.panels.forEach((panel) => panel.resize()); });
    this.net = new Net((m) => this.heard(m), (b) => this.drawn(b), (text, kind) => this.link(text, kind));
    this.side = new Side(this); this.runs = new Runs(this);
    requestAnimationFrame(() => this.frame());
  }

  link(text, kind) { by("link").textContent = text; by("link").className = `pill ${kind}`; }

  heard(message) {
    if (message.about) this.shown(message.about, message.span);
    else if (message.runs) this.runs.heard(message);
    else if (message.refused !== undefined && message.why) {
      this.panels.find((panel) => panel.id === message.refused)?.refused(message.why, message.name);
    }
    this.side.heard(message);
  }

  drawn(buffer) {
    if (this.paused && !this.span) return;
    const head = new Float64Array(buffer, 0, 8);
    this.newest_s = Math.max(this.newest_s, head[7] * head[6]);
    deliver(buffer, this.panels);
  }

  // Another run or log is shown: its variables; panels as they were, without what is gone.
  shown(about, span) {
    this.about = about; this.variables.clear(); this.newest_s = 0;
    for (const list of Object.values(about.nodes)) for (const one of list) this.variables.set(one.name, one);
    document.title = about.rig ? `${about.rig} – pcpc` : "pcpc";
    by("rig").textContent = about.rig || "pcpc";
    this.whole = about.live || span[1] < span[0] ? null : [span[0] * about.period_s, span[1] * about.period_s];
    this.span = this.whole; this.paused = false; by("pause").hidden = !about.live;
    by("pause").textContent = "pause";
    by("panels").hidden = !this.variables.size;
    if (!this.variables.size) { this.side.shown(about, null); this.notice(about.note); return; } // nothing runs yet
    const before = this.panels.map((panel) => panel.layout());
    if (before.some((panel) => panel.names.length) && this.rig === about.rig) this.laid(before);
    else this.laid(this.stored() ?? this.own(about.layout) ?? firstPanels([...this.variables.values()]));
    this.rig = about.rig;
    this.side.shown(about, this.whole);
    if (about.note) this.notice(about.note);
  }

  // The layout that the plant's folder has.
  own(layout) {
    if (!layout?.panels?.every?.((one) => Array.isArray(one?.names))) return null;
    this.use(layout.window_s);
    return layout.panels;
  }

  use(window_s) {
    this.window_s = WINDOWS.includes(window_s) ? window_s : 5;
    by("window").value = String(this.window_s);
  }

  put(panel) { this.panels.push(panel); by("panels").append(panel.box); panel.build(); return panel; }

  drop(panel) {
    this.net.say({ do: "drop", id: panel.id });
    this.panels = this.panels.filter((one) => one !== panel); panel.box.remove();
    this.activate(this.panels[0] ?? null); this.kept();
  }

  activate(panel) {
    this.active = panel;
    for (const one of this.panels) one.box.classList.toggle("active", one === panel);
  }

  // A recorded variable, or an expression of them: = abs(controller.e_rad) * 1000
  plottable(name) { return name.length <= MOST_NAME && name.startsWith("=") || Boolean(this.variables.get(name)?.plot); }

  pick(name) {
    if (!this.active) this.activate(this.put(new TimePanel(this, [])));
    this.active.add(name);
  }

  again() { for (const panel of this.panels) panel.ask(); }

  zoom(span) {
    if (this.about?.live && span) this.pause(true);
    this.span = span ?? (this.paused ? this.still : this.whole);
    this.again();
  }

  pause(on) {
    if (!this.about?.live) return;
    this.paused = on; by("pause").textContent = on ? "go on" : "pause";
    this.still = [this.newest_s - this.window_s, this.newest_s];
    this.span = on ? this.still : null;
    this.again();
  }

  // Layouts: kept in this browser for each rig, or in a file.

  layout() { return { window_s: this.window_s, panels: this.panels.map((panel) => panel.layout()) }; }
  key() { return `pcpc layout ${this.about.rig}`; }
  kept() { if (this.about?.rig) localStorage.setItem(this.key(), JSON.stringify(this.layout())); }

  stored() {
    try {
      const found = JSON.parse(localStorage.getItem(this.key()));
      if (!found) return null;
      this.use(found.window_s);
      return found.panels;
    } catch { return null; }
  }

  laid(panels) {
    for (const panel of this.panels) { this.net.say({ do: "drop", id: panel.id }); panel.box.remove(); }
    this.panels = [];
    const gone = [];
    for (const { kind, names } of panels) {
      const there = names.filter((name) => this.plottable(name)).slice(0, MOST_CURVES);
      const panel = kind === "phase" ? new PhasePanel(this, there) : new TimePanel(this, there);
      panel.gone = names.filter((name) => !there.includes(name)); // they may come, with a node or another run
      gone.push(...panel.gone);
      this.put(panel);
    }
    this.activate(this.panels[0] ?? null);
    this.notice(gone.length ? `not in this run, left out of the layout: ${[...new Set(gone)].join(", ")}` : "");
  }

  save() {
    const link = el("a");
    link.href = URL.createObjectURL(new Blob([JSON.stringify(this.layout(), null, 1)], { type: "application/json" }));
    link.download = `${this.about?.rig ?? "pcpc"}-layout.json`; link.click();
    URL.revokeObjectURL(link.href);
  }

  load() {
    const chosen = el("input"); chosen.type = "file"; chosen.accept = ".json";
    chosen.onchange = async () => {
      try {
        const found = JSON.parse(await chosen.files[0].text());
        this.use(found.window_s);
        this.laid(found.panels.map(({ kind, names }) => ({ kind: String(kind), names: names.map(String) })));
        this.kept();
      } catch (error) { this.notice(`not a layout: ${error.message}`); }
    };
    chosen.click();
  }

  notice(text) { by("notice").textContent = text; by("notice").hidden = !text; }

  at(t_s) { this.instant = t_s; this.net.say({ do: "at", t_s }); for (const panel of this.panels) {
    if (panel.kind === "phase") panel.ask(); else if (panel.x) panel.dirty = true;
  } }

  frame() {
    requestAnimationFrame(() => this.frame()); // first: an error in one frame does not end the others
    this.frames++;
    for (const panel of this.panels) if (panel.dirty) { panel.dirty = false; panel.draw(); }
    this.side.frame();
  }
}

window.pcpc = new Page();
