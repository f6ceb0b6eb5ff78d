// Curves over time and phase planes. Arrays have a fixed size and are filled in place: what is new
// is appended bin by bin, and drawn once per animation frame.

import { alignedRanges, curveColour, darkPage, newestLegend, plotOptions, rangeOf, roomy } from "./axes.js";
import { drawPhase } from "./phase.js";

const HEAD = 8, BINS = 0, PHASE = 2;
const HEIGHT = 240;
export const MOST_CURVES = 32, MOST_NAME = 300; // as the server takes them
let last = 0;

const colours = new Map();
matchMedia("(prefers-color-scheme: dark)").onchange = () => colours.clear();
const css = (name) => {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return colours.get(name);
};
const el = (tag, className, text) => {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
};
export { css, el };

class Panel {
  constructor(page, names) {
    this.page = page; this.names = names; this.gone = []; this.id = ++last; this.dirty = false;
    this.fresh = new Set(); // added by hand, and not drawn yet
    this.box = el("div", "panel"); this.box.tabIndex = 0;
    this.bar = el("div", "bar"); this.plot = el("div");
    this.box.append(this.bar, this.plot);
    this.box.setAttribute("role", "group");
    this.box.onfocus = this.box.onclick = () => page.activate(this);
    this.box.ondragover = (event) => { event.preventDefault(); this.box.classList.add("over"); };
    this.box.ondragleave = () => this.box.classList.remove("over");
    this.box.ondrop = (event) => {
      event.preventDefault(); this.box.classList.remove("over");
      this.add(event.dataTransfer.getData("text/plain"));
    };
  }

  add(name) {
    if (name.length > MOST_NAME) { this.refused(`at most ${MOST_NAME} characters, here are ${name.length}`); return; }
    if (!this.page.plottable(name) || this.names.includes(name)) return;
    if (this.names.length >= MOST_CURVES) { this.refused(`at most ${MOST_CURVES} curves; + panel makes room`); return; }
    this.fresh.add(name);
    this.names.push(name); this.build(); this.page.kept();
  }

  remove(name) {
    this.names = this.names.filter((one) => one !== name); this.build(); this.page.kept();
  }

  chips() {
    this.bar.replaceChildren();
    this.box.setAttribute("aria-label", `curves: ${this.names.join(", ") || "none yet"}`);
    this.names.forEach((name, i) => {
      const chip = el("button", "chip"), mark = el("i");
      mark.style.background = curveColour(i, darkPage());
      const unit = this.page.variables.get(name)?.unit;
      chip.append(mark, `${name}${unit ? ` [${unit}]` : ""} ✕`);
      chip.ariaLabel = `take ${name} away`;
      chip.title = `${this.page.variables.get(name)?.help ?? ""} (click: take away)`;
      chip.onclick = (event) => { event.stopPropagation(); this.remove(name); };
      this.bar.append(chip);
    });
    if (!this.names.length) this.bar.append(el("span", "quiet", "drag variables here, or click them in the list"));
    const close = el("button", "", "close");
    close.ariaLabel = "close this panel";
    close.onclick = (event) => { event.stopPropagation(); this.page.drop(this); };
    this.bar.append(el("span", "grow"), close);
    this.why = el("span", "why"); this.bar.append(this.why);
  }

  // One curve that cannot be had is left out with the reason; the others go on.
  refused(why, name) {
    if (this.names.includes(name)) {
      this.names = this.names.filter((one) => one !== name); this.build();
      if (!this.fresh.delete(name)) this.gone.push(name); // of a layout: it may come
      this.page.kept();
    }
    this.why.textContent = why;
  }
}

export class TimePanel extends Panel {
  constructor(page, names) {
    super(page, names); this.kind = "time"; this.span = null;
    this.box.onkeydown = (event) => { if (event.target === this.box) this.step(event); };
  }

  // The arrows move the cursor by a hundredth of the window, with shift by a tenth.
  step(event) {
    const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!way) return;
    event.preventDefault();
    const { width, height } = this.chart.bbox, wide = width / devicePixelRatio, from = this.chart.cursor.left;
    const left = Math.max(0, Math.min(wide, (from >= 0 ? from : wide) + way * wide * (event.shiftKey ? 0.1 : 0.01)));
    this.chart.setCursor({ left, top: 0.5 * height / devicePixelRatio });
  }

  build() {
    this.chips(); this.end = this.scaled = null; this.held = new Map();
    this.x = this.y = null; this.dirty = false; // what was taken for other curves is not this chart's
    if (this.chart) this.chart.destroy();
    const curves = this.names.map((name) => ({ name, unit: this.unit(name) }));
    this.units = curves.map((one) => one.unit);
    const options = plotOptions({
      curves, width: this.width(), height: HEIGHT, dark: darkPage(), ranges: (units) => this.ranges(units),
      ink: { text: () => css("--text"), line: () => css("--line") },
    });
    this.chart = new uPlot({
      ...options,
      cursor: { sync: { key: "pcpc" }, drag: { x: true, y: false, setScale: false } },
      hooks: {
        ...options.hooks,
        setSelect: [(u) => this.zoom(u)],
        ready: [(u) => u.over.addEventListener("dblclick", () => this.page.zoom(null))],
        draw: [(u) => this.mark(u)],
      },
    }, [[], ...this.names.map(() => [])], this.plot);
    this.ask();
  }

  width() { return Math.max(200, this.plot.clientWidth || this.box.clientWidth - 12 || 600); }

  zoom(u) {
    if (u.select.width < 4) return;
    const at = (px) => u.posToVal(px, "x");
    this.page.zoom([at(u.select.left), at(u.select.left + u.select.width)]);
    u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
  }

  // The scale of a curve: curves of one unit share it, and so do expressions.
  unit(name) { return name.startsWith("=") ? "calculated" : this.page.variables.get(name)?.unit ?? ""; }

  // The range of values: it grows at once and shrinks only by much, so that the axis stands still.
  // uPlot's own takes a NaN at the begin, a cycle that is not there, for the least value.
  range(unit) {
    const now = this.y && rangeOf(this.y.filter((_, c) => (this.units[c] || "1") === unit));
    if (!now) return [0, 1];
    const { low, high } = now, held = this.held.get(unit);
    if (held && low >= held[0] && high <= held[1] && high - low > 0.4 * (held[1] - held[0])) return held;
    this.held.set(unit, roomy(now));
    return this.held.get(unit);
  }

  // Once a drawing; a chart that has been replaced may ask once more, for its own units.
  ranges(units) {
    if (this.scaled?.units !== units) this.scaled = { units, found: alignedRanges(units.map((unit) => this.range(unit))) };
    return this.scaled.found;
  }

  mark(u) {
    const t = this.page.instant;
    if (t === null) return;
    const x = u.valToPos(t, "x", true), { top, height } = u.bbox;
    u.ctx.save(); u.ctx.strokeStyle = css("--bad"); u.ctx.beginPath();
    u.ctx.moveTo(x, top); u.ctx.lineTo(x, top + height); u.ctx.stroke(); u.ctx.restore();
  }

  ask() {
    if (!this.names.length) { this.page.net.say({ do: "drop", id: this.id }); return; }
    const span = this.page.span, cycles = span ? Infinity : Math.round(this.page.window_s / this.page.about.period_s);
    const bins = Math.max(2, Math.min(2000, Math.max(50, this.width() - 80), cycles)); // a short window stays short
    this.bins = bins; this.end = null;
    const time = span ? { from_s: span[0], to_s: span[1] } : { window_s: this.page.window_s };
    this.page.net.say({ do: "panel", id: this.id, names: this.names, bins, ...time });
  }

  take(head, values) {
    const [kind, , curves, first, bins, width, period] = head;
    if (curves !== this.names.length) return;
    this.fresh.clear();
    const each = width > 1 ? 2 : 1, whole = kind !== BINS;
    if (whole || this.end === null) {
      if (!whole) return;
      this.size = this.page.span ? bins : this.bins;
      this.each = each; this.end = first + bins - 1;
      const n = this.size * each;
      this.x = new Float64Array(n);
      this.y = this.names.map(() => new Float32Array(n).fill(NaN));
    }
    const end = first + bins - 1, shift = Math.min(end - this.end, this.size) * each;
    if (shift > 0) for (const y of this.y) { y.copyWithin(0, shift); y.fill(NaN, y.length - shift); }
    this.end = Math.max(end, this.end);
    const begin = this.end - this.size + 1;
    for (let i = 0; i < this.x.length; i++) this.x[i] = (begin + i / each) * width * period;
    for (let c = 0; c < curves; c++) {
      const low = c * bins, high = (curves + c) * bins, y = this.y[c];
      for (let b = Math.max(0, begin - first); b < bins; b++) {
        const at = (first + b - begin) * each;
        y[at] = values[low + b];
        if (each === 2) y[at + 1] = values[high + b];
      }
    }
    this.dirty = true;
  }

  draw() { this.scaled = null; this.chart.setData([this.x, ...this.y], true); newestLegend(this.chart); }
  resize() {
    const width = this.width();
    if (width === this.chart.width) return;
    this.chart.setSize({ width, height: HEIGHT }); this.ask();
  }
  layout() { return { kind: "time", names: [...this.names, ...this.gone] }; }
}

export class PhasePanel extends Panel {
  constructor(page, names) {
    super(page, names); this.kind = "phase";
    this.canvas = el("canvas", "phase"); this.plot.append(this.canvas);
  }

  build() { this.names = this.names.slice(-2); this.chips(); this.points = null; this.dirty = false; this.ask(); }

  ask() {
    if (this.names.length < 2) {
      this.page.net.say({ do: "drop", id: this.id });
      this.why.textContent = "two variables: the second over the first"; return;
    }
    const to = this.page.instant ?? this.page.span?.[1];
    this.page.net.say({
      do: "phase", id: this.id, names: this.names, points: 2000, window_s: this.page.window_s,
      ...(to === undefined || to === null ? {} : { to_s: to }),
    });
  }

  take(head, values) {
    const n = head[4];
    this.points = [values.subarray(0, n), values.subarray(n, 2 * n)]; this.dirty = true;
  }

  draw() {
    drawPhase(this.canvas, this.points, this.names, { text: () => css("--text"), line: () => css("--line") });
  }

  resize() { this.dirty = this.points !== null; }
  layout() { return { kind: "phase", names: [...this.names, ...this.gone] }; }
}

// Hand a binary message to its panel.
export function deliver(buffer, panels) {
  const head = new Float64Array(buffer, 0, HEAD), values = new Float32Array(buffer, 8 * HEAD);
  const panel = panels.find((one) => one.id === head[1]);
  if (panel && (panel.kind === "phase") === (head[0] === PHASE)) panel.take(head, values);
}
