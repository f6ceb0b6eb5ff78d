// The page of one rig: what is chosen, what runs, and what is told of it.
import { Run, contents } from "./run.js";
import { judge, shortNumber } from "./judge.js";
import { logBytes, readLog } from "./log.js";
import { Plant } from "./plant.js";
import { Panes } from "./panes.js";
import { byId, digits, element } from "./view.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, Infinity], WINDOWS = [0.5, 1, 2, 5, 10, 20, 60, Infinity];
const LINES = 12, LINE = 300; // of a notice, whatever a link or a file says
const still = matchMedia("(prefers-reduced-motion: reduce)").matches;

class WebPage {
  constructor(about, module) {
    this.about = about; this.module = module; this.tunings = []; this.changed = new Map(); this.running = false;
    this.id = 0; this.asked = 0; this.drawn = -1; this.again = 0;
    const worker = new Blob([byId("worker").textContent], { type: "text/javascript" });
    this.worker = new Worker(URL.createObjectURL(worker));
    this.worker.onmessage = ({ data }) => this.heard(data);
    for (const one of about.controllers) byId("controller").append(new Option(one.name));
    for (const one of SPEEDS) byId("speed").append(new Option(one === Infinity ? "fastest" : `${one} ×`, one, one === 1, one === 1));
    const window_s = about.layout?.window_s ?? 5;
    for (const one of WINDOWS) byId("window").append(new Option(one === Infinity ? "whole run" : `${one} s`, one, one === window_s, one === window_s));
    byId("about").textContent = `${about.rig}: ${about.nodes.length} nodes, ${about.rate_hz} Hz; made by pcpc ${about.version}. `
      + "All is computed here: the file loads nothing and sends nothing.";
    for (const one of about.absent) byId("absent").append(element("li", `without ${one.name}: ${one.why}`));
    byId("controller").onchange = () => { this.changed.clear(); this.restart(); };
    byId("seed").onchange = () => this.restart();
    byId("go").onclick = () => this.go(!this.running);
    byId("step").onclick = () => this.step(1);
    byId("again").onclick = () => this.restart();
    byId("speed").onchange = () => { if (this.running) this.go(true); };
    byId("window").onchange = () => this.draw();
    byId("search").oninput = () => this.searched();
    byId("copy").onclick = () => this.copied(byId("command").textContent, "command");
    byId("link").onclick = () => this.copied(location.href.split("#")[0] + this.link(), "link");
    byId("save").onclick = () => this.save();
    byId("open").onchange = ({ target }) => { this.open(target.files[0]); target.value = ""; };
    document.addEventListener("dragover", (event) => event.preventDefault());
    document.addEventListener("drop", (event) => { event.preventDefault(); this.open(event.dataTransfer.files[0]); });
    addEventListener("hashchange", () => { if (location.hash !== this.link()) this.linked(); });
    addEventListener("resize", () => { this.panels.resize(); this.draw(); });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.show());
    document.addEventListener("keydown", (event) => this.key(event));
    this.panels = new Panes(about, () => history.replaceState(null, "", this.link()));
    this.plant = new Plant();
    this.linked();
    requestAnimationFrame(() => this.frame());
  }

  get controller() { return this.about.controllers.find((one) => one.name === byId("controller").value); }

  key(event) {
    if (event.target !== document.body || event.ctrlKey || event.metaKey || event.altKey) return;
    const action = { " ": () => this.go(!this.running), ".": () => this.step(1), ">": () => this.step(100) }[event.key];
    if (action) { event.preventDefault(); action(); }
  }

  // The link's settings; what is wrong of them is told and left out.
  linked() {
    const wrong = [], given = new URLSearchParams(location.hash.slice(1));
    const names = this.about.controllers.map((one) => one.name);
    const name = given.get("controller") ?? names[0];
    if (!names.includes(name)) wrong.push(`controller=${name}: there are ${names.join(", ")}`);
    byId("controller").value = names.includes(name) ? name : names[0];
    this.changed.clear();
    for (const [key, text] of given) {
      if (["controller", "seed", "panels"].includes(key)) continue;
      const one = this.value(key), value = Number(text);
      if (!one) wrong.push(`${key}: no such parameter of ${this.controller.name}`);
      else if (text.trim() === "" || !(value >= one.low && value <= one.high)) wrong.push(`${key}=${text}: expected ${one.low} to ${one.high} ${one.unit}`);
      else this.changed.set(key, value);
    }
    const seed = given.get("seed");
    this.seeds("");
    if (seed !== null && ![...byId("seed").options].some((one) => one.value === seed)) wrong.push(`seed=${seed}: this file has ${[...byId("seed").options].map((one) => one.value).join(", ")}`);
    else if (seed !== null) byId("seed").value = seed;
    wrong.push(...this.panels.linked(given.get("panels")));
    this.notice(wrong.length ? `The link was not taken whole.\n${wrong.join("\n")}` : "");
    this.restart(true);
  }

  key_of(one) { return one.node === this.about.nodes[0] ? one.name : `${one.node}:${one.name}`; }
  value(key) { return this.controller.values.find((one) => this.key_of(one) === key); }
  seeds(before = byId("seed").value) {
    const { seed, seeds } = this.controller;
    byId("seed").replaceChildren(...[seed, ...Object.keys(seeds)].map((one) => new Option(one)));
    byId("seed-box").hidden = !Object.keys(seeds).length;
    if (before in seeds) byId("seed").value = before;
  }

  link() {
    const given = new URLSearchParams({ controller: this.controller.name });
    if (+byId("seed").value !== this.controller.seed) given.set("seed", byId("seed").value);
    for (const [key, value] of this.changed) given.set(key, value);
    if (this.panels.link() !== null) given.set("panels", this.panels.link());
    return `#${given}`;
  }

  // The same run natively; "" where no command line says it.
  command() {
    const quoted = (text) => (/^[\w.:=/+,-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
    const words = ["pcpc simulate", quoted(this.about.called), "--controller", quoted(this.controller.name)];
    const set = (text) => words.push("--set", quoted(text));
    this.about.settings.forEach(set);
    if (+byId("seed").value !== this.controller.seed) set(`seed=${byId("seed").value}`);
    const later = this.tunings.map(({ at, one, value }) => ({ at_s: at * this.about.period_s, one, value }));
    for (const [key, value] of this.changed) {
      const one = this.value(key);
      if (one.set) set(`${one.name}=${value}`);
      else later.unshift({ at_s: 0, one, value });
    }
    if (later.some(({ one }) => one.node !== this.about.nodes[0])) return "";
    if (later.length) {
      const entry = ({ at_s, one, value }) => `{at_s: ${+at_s.toPrecision(9)}, set: {${one.name}: ${value}}}`;
      const own = this.about.schedule.flatMap((each) => Object.entries(each.set).map(([name, value]) => `{at_s: ${each.at_s}, set: {${name}: ${value}}}`));
      set(`schedule=[${[...own, ...later.map(entry)].join(", ")}]`);
    }
    return [...words, "--digest"].join(" ");
  }

  restart(keepsHash = false) {
    this.running = false; this.tunings = []; this.drawn = -1; this.ended = false; this.log = null;
    this.seeds();
    this.run = new Run(this.controller, this.about.nodes, this.about.period_s);
    if (!keepsHash) history.replaceState(null, "", this.link());
    const { module, columns, cycles } = this.controller, nodes = this.about.nodes;
    this.worker.postMessage({
      kind: "start", id: ++this.id, module: this.module(module), columns: nodes.map((node) => columns[node].length), cycles,
      periodS: this.about.period_s,
      values: [...(this.controller.seeds[byId("seed").value] ?? []),
        ...[...this.changed].map(([key, value]) => [nodes.indexOf(this.value(key).node), this.value(key).at, value])],
    });
    this.state("starting", "");
    byId("digest").textContent = ""; byId("requirements").replaceChildren(); byId("metrics").replaceChildren();
    this.controls(); this.told(); this.show();
  }

  heard(data) {
    if (data.id !== this.id) return;
    if (data.kind === "rows") { this.run.take(data.parts); }
    else if (data.kind === "failed") { this.state("failed", "bad"); this.notice(data.why); }
    else if (data.kind === "ready") { this.state("ready", ""); this.draw(); }
    else if (data.kind === "ended") this.end();
    else if (data.kind === "tuned") {
      const asked = this.pending.get(data.tuning), own = (one) => one.node === this.about.nodes[0];
      this.pending.delete(data.tuning);
      asked.forEach(({ one }, k) => { // the lower nodes are a cycle ahead
        this.tunings.push({ at: data.now + (own(one) ? 0 : 1), one, value: data.given[k] });
        this.sliders.get(one)?.(data.given[k]);
      });
      const words = asked.map(({ one }, k) => `${one.name} = ${digits(data.given[k])}`);
      byId("answer").textContent = `${words.join(", ")} from cycle ${this.tunings.at(-1).at} on`;
      this.told();
    }
  }

  go(on) {
    if (this.log) { this.play(on); return; }
    if (this.ended && on) this.restart();
    this.running = on && !this.ended;
    this.worker.postMessage({ kind: "go", speed: this.running ? +byId("speed").value : 0 });
    this.state(this.running ? "running" : "paused", this.running ? "good" : "");
  }

  // A log that was opened: what was recorded, as fast as it is asked for.
  play(on) {
    if (on && this.run.cursor >= this.log.cycles) this.run.cursor = 0;
    this.running = on;
    this.began = { cursor: this.run.cursor, at: performance.now() };
    this.state(on ? "playing" : "paused", on ? "good" : "");
  }

  played() {
    const speed = +byId("speed").value, went = (performance.now() - this.began.at) * 1e-3 * speed / this.about.period_s;
    this.run.cursor = Math.min(this.log.cycles, this.began.cursor + (speed === Infinity ? Infinity : Math.floor(went)));
    if (this.run.cursor >= this.log.cycles) { this.running = false; this.state("end of the log", ""); }
  }

  async open(file) {
    if (!file) return;
    try {
      if (this.controller.log.why) throw new Error(this.controller.log.why);
      if (file.size > 200e6) throw new Error(`the log has ${Math.round(file.size / 1e6)} MB; a page reads 200`);
      const bytes = new Uint8Array(await file.arrayBuffer());
      const found = readLog(this.controller.log, bytes);
      if (found.cycles > this.controller.cycles) throw new Error(`the log has ${found.cycles} cycles, this page's run ${this.controller.cycles}`);
      this.restart();
      this.run.fill(found);
      this.id += 1; // what is computed is left
      this.log = found;
      this.notice(`${file.name}: ${found.cycles} cycles of a log${found.same ? "" : ", of a rig that was changed"}; restart ends it`);
      this.show(); this.play(true);
    } catch (error) { this.notice(`${file.name}: ${error.message}`); }
  }

  save() {
    try {
      if (this.controller.log.why) throw new Error(this.controller.log.why);
      if (this.log) throw new Error("this is a log already");
      if (!this.run.done) throw new Error("nothing has run yet");
      if (this.run.odd()) throw new Error("a value was not finite: natively the run had ended there");
      if (+byId("seed").value !== this.controller.seed) throw new Error("a log of another seed is of another rig: run the command");
      const settings = Object.fromEntries([...this.changed].map(([key, value]) => [`${this.value(key).node}:${this.value(key).name}`, value]));
      const tunings = this.tunings.map(({ at, one, value }) => ({ cycle: at, node: one.node, name: one.name, value }));
      const bytes = logBytes(this.controller.log, { cycles: this.run.done, column: (name) => this.run.record(name), settings, tunings });
      const link = element("a", "", { download: `${this.about.rig}-${this.controller.name}.mcap` });
      link.href = URL.createObjectURL(new Blob([bytes]));
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
      byId("said").textContent = `${this.run.done} cycles; pcpc replay ${link.download}`;
    } catch (error) { byId("said").textContent = error.message; }
  }

  step(cycles) {
    if (this.log) { this.play(false); this.run.cursor = Math.min(this.log.cycles, this.run.cursor + cycles); this.draw(); return; }
    if (this.ended) return;
    this.running = false;
    this.state("paused", "");
    this.worker.postMessage({ kind: "step", cycles });
  }

  async end() {
    this.running = false; this.ended = true;
    this.state("judging", ""); this.draw();
    const run = this.run, odd = run.odd(), line = byId("digest");
    if (odd) {
      line.className = "bad";
      line.textContent = `${odd.name} is not finite at ${digits(odd.cycle * run.periodS)} s: natively a safety stop, which a page does not have`;
      this.state("not finite", "bad");
      return;
    }
    const found = await run.digest();
    if (run !== this.run) return;
    const plain = !this.changed.size && !this.tunings.length && +byId("seed").value === this.controller.seed;
    const short = found.slice(0, 16), native = this.controller.digest;
    line.className = plain ? (found === native ? "good" : "bad") : "";
    if (!plain) line.textContent = `digest ${short}; ${this.command() ? "the command below prints the same" : "what was changed of the plant is in no command"}`;
    else if (found === native) line.textContent = `equal to pcpc ${this.about.version} on ${this.about.machine}: ${short}, see the command below`;
    else line.textContent = `DIFFERS from pcpc ${this.about.version} on ${this.about.machine}: ${short}, not ${native.slice(0, 16)}`;
    line.title = found;
    this.judged();
  }

  // As `pcpc simulate` judges; what is made of a setting that was changed is left to it.
  judged() {
    const changed = new Set([...this.changed.keys()].filter((key) => this.value(key).set).map((key) => key.split(".").at(-1)));
    const known = (one) => { const name = one.settings?.find((each) => changed.has(each)); return name ? { ...one, why: `${name} was changed` } : one; };
    const { metrics, requirements, ...data } = this.controller.judge;
    const asked = { ...data, metrics: metrics.map(known), requirements: requirements.map(known) };
    const verdict = judge(asked, (name) => this.run.record(name), this.run.done, this.about.period_s);
    const judged = [...verdict.requirements, ...verdict.metrics].filter((one) => typeof one.met === "boolean").length;
    if (verdict.word === "ok" && !judged) this.state("nothing judged", "warn");
    else this.state(verdict.word + (judged ? `, ${judged} judged` : ""), { ok: "good", "expectation not met": "bad" }[verdict.word] ?? "warn");
    const mark = (met) => [{ true: "✓", false: "✗" }[met] ?? "–", { true: "good", false: "bad" }[met] ?? "quiet"];
    byId("requirements").replaceChildren(...verdict.requirements.map((one) => row([mark(one.met), [one.words]])));
    byId("metrics").replaceChildren(...verdict.metrics.map((one) => row([
      mark(one.met), [one.name], [one.value === null ? one.why : shortNumber(one.value, 4), "number"],
      [one.limit ? one.limit.map((limit) => shortNumber(limit, 4)).join(" to ") : "", "quiet"]])));
  }

  controls() {
    this.pending = new Map();
    if (this.sliders?.of === this.controller) { // who has the focus keeps it
      for (const [one, say] of this.sliders) say(this.changed.get(this.key_of(one)) ?? one.value);
      return;
    }
    this.sliders = Object.assign(new Map(), { of: this.controller });
    byId("values").replaceChildren(...this.controller.values.map((one) => this.control(one)));
    this.searched();
    byId("disturbances").replaceChildren(...this.about.disturbances.flatMap(({ label, set }) => {
      const all = set.map(([name, value, later]) => ({ one: this.value(name), value, later: Boolean(later) }));
      if (!all.every(({ one }) => one)) return []; // another controller's
      const button = element("button", label, { title: all.map(({ one, value, later }) => `${one.name} = ${later ? "now + " : ""}${digits(value)} ${one.unit}`).join("\n") });
      button.onclick = () => this.tune(all);
      return button;
    }));
    byId("disturbances").hidden = !byId("disturbances").children.length;
  }

  control(one) {
    const key = this.key_of(one), label = element("label", "", { title: one.help }), shown = element("output");
    const range = element("input", "", { type: "range", min: 0, max: 1000, "aria-label": `${key} ${one.unit}` });
    const now = this.changed.get(key) ?? one.value, span = one.high - one.low;
    // Of a range of decades the slider is a power: near the value that the rig has it is fine.
    const part = Math.min(0.9, Math.max(0.1, (one.value - one.low) / span)), bent = one.value > one.low ? Math.log((one.value - one.low) / span) / Math.log(Math.max(0.5, part)) : 1;
    const power = Math.max(1, Math.min(12, bent));
    const at = (value) => 1000 * ((value - one.low) / span) ** (1 / power);
    const value = () => (Math.abs(+range.value - at(one.value)) < 1 ? one.value : +(one.low + span * (+range.value / 1000) ** power).toPrecision(4));
    range.value = at(now);
    const say = (it) => { shown.textContent = `${digits(it)} ${one.unit}`; label.classList.toggle("changed", it !== one.value); range.setAttribute("aria-valuetext", `${digits(it)} ${one.unit}`); };
    say(now);
    this.sliders.set(one, (it) => { range.value = at(it); say(it); });
    range.oninput = () => say(value());
    range.onchange = () => this.tune([{ one, value: value() }]);
    label.append(element("span", key), shown, range);
    label.dataset.key = key.toLowerCase();
    return label;
  }

  // Before a run begins it begins so; later it is a tuning at the cycle that comes next. `later`: a time after it.
  tune(all) {
    if (this.ended || this.log) this.restart();
    if (this.run.counts[0] === 0) {
      for (const { one, value } of all) this.changed.set(this.key_of(one), value);
      byId("answer").textContent = `${all.map(({ one, value }) => `${one.name} = ${digits(value)}`).join(", ")} from the begin on`;
      this.restart();
      return;
    }
    const tuning = ++this.asked;
    this.pending.set(tuning, all);
    this.worker.postMessage({ kind: "set", tuning, values: all.map(({ one, value, later }) => [this.about.nodes.indexOf(one.node), one.at, value, later]) });
  }

  searched() {
    const text = byId("search").value.toLowerCase();
    for (const label of byId("values").children) label.hidden = !label.dataset.key.includes(text);
  }

  told() {
    const command = this.command();
    byId("command").textContent = command || "what was changed of the plant is in no command";
    byId("copy").disabled = !command;
  }

  async copied(text, what) {
    try { await navigator.clipboard.writeText(text); byId("said").textContent = `the ${what} is in the clipboard`; }
    catch { byId("said").textContent = text; }
  }

  state(text, kind) {
    byId("state").textContent = text; byId("state").className = `pill ${kind}`;
    byId("go").textContent = this.running ? "pause" : this.ended ? "run again" : "run";
  }

  notice(text) {
    const lines = text.split("\n").map((line) => (line.length > LINE ? `${line.slice(0, LINE)} …` : line));
    if (lines.length > LINES) lines.splice(LINES, Infinity, `and ${lines.length - LINES} more`);
    byId("notice").hidden = !text; byId("notice").textContent = lines.join("\n");
  }

  show() { this.panels.shown(this.run); this.plant.shown(this.run); this.drawn = -1; this.draw(); }

  // Settings of the plant as they are now, by their names in its blocks.
  plantSettings() {
    const now = [...[...this.changed].map(([key, value]) => ({ one: this.value(key), value })), ...this.tunings];
    const own = now.filter(({ one }) => one.node === "plant");
    return Object.fromEntries(own.map(({ one, value }) => [one.name.slice(one.name.indexOf(".") + 1), value]));
  }

  frame() {
    if (this.log && this.running) this.played();
    if (this.run.done !== this.drawn && (!still || performance.now() > this.again)) { this.again = performance.now() + 500; this.draw(); }
    requestAnimationFrame(() => this.frame());
  }

  draw() {
    this.drawn = this.run.done;
    const window_s = Math.min(+byId("window").value, this.run.cycles * this.about.period_s);
    this.panels.draw(window_s);
    this.plant.draw(this.log ? {} : this.plantSettings());
    byId("clock").textContent = `${(this.drawn * this.about.period_s).toFixed(3)} s of ${(this.run.cycles * this.about.period_s).toFixed(3)} s`;
  }
}

function row(cells) {
  const made = element("tr");
  made.append(...cells.map(([text, kind]) => element("td", text, kind ? { class: kind } : {})));
  return made;
}

contents(byId("payload").textContent).then(
  ({ about, module }) => { globalThis.page = new WebPage(about, module); },
  (error) => { byId("notice").hidden = false; byId("notice").textContent = `This file is damaged: ${error.message}`; },
);
