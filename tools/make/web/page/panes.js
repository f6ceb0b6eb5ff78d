// The panels of a page: curves over time and phase planes, and the list from which the reader fills them.
import { curveColour, darkPage, firstPanels, newestLegend, plotOptions, valueText } from "./axes.js";
import { drawPhase } from "./phase.js";
import { byId, css, curvePoints, element } from "./view.js";

const BINS = 600, POINTS = 2000, HEIGHT = 190, SPOKEN_MS = 1000;
const MOST = { panels: 12, curves: 32, listed: 200 };
const KINDS = { time: "curves over time", phase: "phase plane" };
const ink = { text: () => css("--text"), line: () => css("--line") };

class Pane {
  constructor(panes, kind, names) {
    this.panes = panes; this.kind = kind; this.names = names; this.places = []; this.spoken = 0; this.speaks = 0;
    this.box = element("div", "", { class: "panel", role: "group" });
    this.bar = this.box.appendChild(element("div", "", { class: "bar" }));
    this.view = this.box.appendChild(element("div", "", { role: "img" }));
    this.box.addEventListener("focusin", () => panes.choose(this));
    this.box.addEventListener("click", () => panes.choose(this));
  }

  // For a run of a controller: what it does not have is not shown, and comes back with another.
  shown(run) {
    this.run = run;
    this.places = this.names.map((name) => [name, run.place(name)]).filter(([, place]) => place);
    this.box.hidden = this.names.length > 0 && !this.places.length;
    this.box.setAttribute("aria-label", `panel ${this.panes.all.indexOf(this) + 1}, ${KINDS[this.kind]}`);
    this.bar.replaceChildren(...this.places.map(([name, place], i) => this.chip(name, place, i)));
    if (!this.places.length) this.bar.append(element("span", "no variable yet", { class: "quiet" }));
    this.button("+ variable", "add a variable to this panel", () => this.panes.asked(this));
    this.button("close", "close this panel", () => this.panes.remove(this));
    if (!this.box.hidden) this.built();
    this.told();
  }

  button(text, label, done) {
    const made = this.bar.appendChild(element("button", text, { "aria-label": label, title: label }));
    made.onclick = (event) => { event.stopPropagation(); done(); };
  }

  chip(name, { unit, help }, i) {
    const chip = element("button", "", { class: "chip", "aria-label": `take ${name} away`, title: `${help} (click: take away)` });
    const mark = element("i");
    mark.style.background = curveColour(i, darkPage());
    if (this.kind === "time") chip.append(mark);
    chip.append(`${name}${unit ? ` [${unit}]` : ""} ✕`);
    chip.onclick = (event) => {
      event.stopPropagation();
      this.names = this.names.filter((one) => one !== name);
      this.panes.changed(`${name} is taken away`);
      this.bar.querySelector("button").focus();
    };
    return chip;
  }

  // The newest values as words, at most once a second: a picture has nothing else for who does not see it.
  speak() {
    const wait = this.spoken + SPOKEN_MS - performance.now();
    if (wait <= 0) this.told();
    else this.speaks ||= setTimeout(() => this.told(), wait);
  }

  told() {
    clearTimeout(this.speaks);
    this.speaks = 0; this.spoken = performance.now();
    const last = this.run.done - 1;
    const values = this.places.map(([name, { unit, values }]) => `${name} = ${valueText(values[last], unit)}`);
    this.view.setAttribute("aria-label", `${this.title()}${last < 0 ? "" : `; newest values: ${values.join(", ")}`}`);
  }

  draw(windowS) {
    if (this.box.hidden || !this.ready) return;
    const last = this.run.done, first = Math.max(0, last - Math.round(windowS / this.run.periodS));
    this.drawn(first, last);
    this.speak();
  }
}

class TimePane extends Pane {
  get ready() { return Boolean(this.plot); }

  title() { return `${KINDS.time}: ${this.places.map(([name]) => name).join(", ") || "none"}`; }

  built() {
    this.plot?.destroy();
    this.plot = null;
    if (!this.places.length) return;
    const curves = this.places.map(([name, { unit }]) => ({ name, unit }));
    const options = plotOptions({ curves, width: this.width(), height: HEIGHT, dark: darkPage(), ink });
    this.plot = new uPlot(options, [[], ...curves.map(() => [])], this.view);
  }

  drawn(from, last) {
    const width = Math.max(1, Math.ceil((last - from) / BINS)), first = from - from % width; // bins stay where they are
    this.plot.setData(curvePoints(this.places.map(([, place]) => place.values), first, last, width, this.run.periodS), true);
    newestLegend(this.plot);
  }

  width() { return Math.max(200, this.box.clientWidth - 12); }
  resize() { this.plot?.setSize({ width: this.width(), height: HEIGHT }); }
}

class PhasePane extends Pane {
  get ready() { return this.places.length === 2; }

  title() { return this.ready ? `${KINDS.phase}: ${this.places[1][0]} over ${this.places[0][0]}` : `${KINDS.phase}: needs two variables`; }

  built() {
    this.canvas ??= this.view.appendChild(element("canvas", "", { class: "phase" }));
    this.canvas.hidden = !this.ready;
    if (!this.ready) this.bar.append(element("span", "two variables: the second over the first", { class: "quiet" }));
  }

  drawn(from, last) {
    const stride = Math.max(1, Math.ceil((last - from) / POINTS)), points = this.places.map(() => []);
    const take = (k) => this.places.forEach(([, { values }], c) => points[c].push(values[k]));
    for (let k = from - from % stride; k < last - 1; k += stride) take(k);
    if (last) take(last - 1);
    drawPhase(this.canvas, points, this.places.map(([name, { unit }]) => (unit ? `${name} [${unit}]` : name)), ink);
  }

  resize() {}
}

export class Panes {
  constructor(about, kept) {
    this.about = about; this.kept = kept; this.all = []; this.chosen = null;
    const own = this.usual().flatMap(({ names }) => names);
    this.known = new Set([...own, ...about.controllers.flatMap(({ columns }) => about.nodes.flatMap((node) => columns[node].flatMap(([name]) => [name, `${node}:${name}`])))]);
    byId("add-time").onclick = () => this.add("time");
    byId("add-phase").onclick = () => this.add("phase");
    byId("usual").onclick = () => { this.set(this.usual()); this.changed("the panels are the rig's own"); };
    byId("into").onchange = () => this.choose(this.all[byId("into").selectedIndex]);
    byId("find").oninput = () => this.list();
    byId("variables-box").ontoggle = () => this.list();
  }

  usual() {
    const given = this.about.layout?.panels?.filter((one) => one.kind in KINDS);
    if (given) return given;
    const [top, ...below] = this.about.nodes, columns = this.about.controllers[0].columns;
    const named = (node, before) => columns[node].map(([name, unit, , , kind]) => ({ name: before + name, unit, kind, plot: true }));
    return firstPanels([named(top, ""), ...below.map((node) => named(node, `${node}:`))].flat());
  }

  set(list) {
    this.all = list.map(({ kind, names }) => new (kind === "phase" ? PhasePane : TimePane)(this, kind, [...names]));
    this.chosen = this.all[0] ?? null;
    byId("panels").replaceChildren(...this.all.map((one) => one.box));
  }

  // As a link has them: panels by semicolons, in each its kind and its names by commas. "" is the rig's own.
  text(list = this.all) { return list.map(({ kind, names }) => [kind, ...names].join(",")).join(";"); }
  link() { const now = this.text(); return now === this.text(this.usual()) ? null : now; }

  // Take a link's panels; what is wrong is left out and returned in words.
  linked(text) {
    const wrong = [];
    const list = (text ?? "").split(";").filter(Boolean).slice(0, MOST.panels).flatMap((one) => {
      const [kind, ...names] = one.split(",");
      if (!(kind in KINDS)) { wrong.push(`panels: ${kind}: there are ${Object.keys(KINDS).join(", ")}`); return []; }
      const odd = names.filter((name) => !this.known.has(name));
      if (odd.length) wrong.push(`panels: no such variable: ${odd.join(", ")}`);
      const most = kind === "phase" ? 2 : MOST.curves;
      return [{ kind, names: [...new Set(names)].filter((name) => this.known.has(name)).slice(0, most) }];
    });
    this.set(text === null ? this.usual() : list);
    return wrong;
  }

  changed(words) {
    this.all.forEach((one) => one.shown(this.run));
    this.listed();
    if (this.windowS) this.draw(this.windowS);
    byId("panels-said").textContent = words;
    this.kept();
  }

  add(kind) {
    if (this.all.length >= MOST.panels) { byId("panels-said").textContent = `at most ${MOST.panels} panels`; return; }
    const made = new (kind === "phase" ? PhasePane : TimePane)(this, kind, []);
    this.all.push(made);
    byId("panels").append(made.box);
    this.choose(made);
    this.changed(`panel ${this.all.length} is new`);
    this.asked(made);
  }

  remove(pane) {
    const at = this.all.indexOf(pane);
    this.all.splice(at, 1);
    pane.box.remove();
    const next = this.all[Math.min(at, this.all.length - 1)];
    this.choose(next);
    this.changed(`panel ${at + 1} is closed`);
    (next?.bar.querySelector("button") ?? byId("add-time")).focus();
  }

  // The panel that takes what is pressed in the list of variables.
  choose(pane) {
    this.chosen = pane ?? null;
    for (const one of this.all) one.box.classList.toggle("active", one === pane && this.all.length > 1);
    byId("into").selectedIndex = this.all.indexOf(pane);
  }

  asked(pane) { this.choose(pane); byId("variables-box").open = true; byId("find").focus(); }

  took(name) {
    if (!this.chosen) this.add("time");
    const { names, kind } = this.chosen, where = `panel ${this.all.indexOf(this.chosen) + 1}`;
    if (names.includes(name)) byId("panels-said").textContent = `${name} is in ${where} already`;
    else if (names.length >= MOST.curves) byId("panels-said").textContent = `at most ${MOST.curves} curves in a panel`;
    else {
      this.chosen.names = [...names, name].slice(kind === "phase" ? -2 : 0);
      this.changed(`${name} is in ${where}`);
    }
  }

  listed() {
    byId("into").replaceChildren(...this.all.map(({ kind }, i) => new Option(`panel ${i + 1}, ${KINDS[kind]}`)));
    this.choose(this.all.includes(this.chosen) ? this.chosen : this.all[0]);
  }

  // All variables of the run whose name, unit and meaning have all words that are searched for.
  list() {
    if (!byId("variables-box").open) return;
    const words = byId("find").value.toLowerCase().split(/\s+/).filter(Boolean), top = `${this.about.nodes[0]}:`, found = [];
    for (const [key, { unit, help }] of this.run.places) {
      const name = key.startsWith(top) ? key.slice(top.length) : key, all = `${name} ${unit} ${help}`.toLowerCase();
      if (words.every((word) => all.includes(word))) found.push({ name, unit, help });
    }
    byId("variables").replaceChildren(...found.slice(0, MOST.listed).map(({ name, unit, help }) => {
      const button = element("button", `${name}${unit ? ` [${unit}]` : ""}`), item = element("li");
      button.append(element("span", help, { class: "quiet" }));
      button.onclick = () => this.took(name);
      item.append(button);
      return item;
    }));
    byId("more").textContent = `${found.length} variables${found.length > MOST.listed ? `, the first ${MOST.listed} are here: search` : ""}`;
  }

  shown(run) {
    const other = this.run?.controller !== run.controller;
    this.run = run;
    this.all.forEach((one) => one.shown(run));
    this.listed();
    if (other) this.list();
  }

  draw(windowS) { this.windowS = windowS; this.all.forEach((one) => one.draw(windowS)); }
  resize() { this.all.forEach((one) => one.resize()); }
}
