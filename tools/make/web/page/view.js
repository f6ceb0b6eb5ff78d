// What is seen of a run: curves over time, and the plant's drawing.
import { paint } from "./drawing.js";

const BINS = 600, HEIGHT = 190;
const COLOURS = ["--role-moving", "--role-magnified", "--good", "--role-force", "--role-ghost", "--quiet"];

export const byId = (id) => document.getElementById(id);

export function element(name, text = "", attributes = {}) {
  const made = document.createElement(name);
  made.textContent = text;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

export function digits(value) {
  if (value === undefined || Number.isNaN(value)) return "–";
  return Number.isFinite(value) ? String(+value.toPrecision(6)) : value > 0 ? "inf" : "-inf";
}

export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// The least and the greatest value of each of `width` cycles in their order, so that no spike is lost.
export function envelope(values, first, last, width) {
  const found = [];
  for (let k = first; k < last; k += width) {
    let low = k, high = k;
    for (let i = k; i < Math.min(k + width, last); i++) {
      if (values[i] < values[low]) low = i;
      if (values[i] > values[high]) high = i;
    }
    found.push(values[Math.min(low, high)]);
    if (width > 1) found.push(values[Math.max(low, high)]);
  }
  return found;
}

export class Curves {
  constructor(box, names) {
    this.names = names; this.box = box.appendChild(element("div", "", { class: "panel" }));
    this.plot = null;
  }

  shown(run) {
    this.places = this.names.map((name) => [name, run.place(name)]).filter(([, place]) => place);
    this.run = run;
    this.plot?.destroy();
    this.plot = null;
    this.box.hidden = !this.places.length;
    if (this.box.hidden) return;
    const units = [...new Set(this.places.map(([, place]) => place.unit))];
    const grid = { stroke: css("--line"), width: 1 }, axis = { stroke: css("--text"), ticks: grid };
    this.plot = new uPlot({
      width: this.box.clientWidth - 8, height: HEIGHT, cursor: { show: false }, legend: { show: true, live: true },
      scales: { x: { time: false } },
      axes: [{ ...axis, grid }, ...units.slice(0, 2).map((unit, i) => (
        { ...axis, scale: unit || "1", side: i ? 1 : 3, label: unit || "1", size: 62, grid: i ? { show: false } : grid }))],
      series: [{}, ...this.places.map(([name, place], i) => (
        { label: name, scale: place.unit || "1", stroke: css(COLOURS[i % COLOURS.length]), width: 1.5, points: { show: false } }))],
    }, [[], ...this.places.map(() => [])], this.box);
  }

  draw(windowS) {
    if (!this.plot) return;
    const last = this.run.done, period = this.run.periodS;
    let first = Math.max(0, last - Math.round(windowS / period));
    const width = Math.max(1, Math.ceil((last - first) / BINS));
    first -= first % width; // bins stay where they are while time goes on
    const x = [];
    for (let k = first; k < last; k += width) { x.push(k * period); if (width > 1) x.push((k + 0.5 * width) * period); }
    this.plot.setData([x, ...this.places.map(([, place]) => envelope(place.values, first, last, width))]);
  }

  resize() { this.plot?.setSize({ width: this.box.clientWidth - 8, height: HEIGHT }); }
}

export class Plant {
  constructor(needs, scene) {
    this.needs = needs; this.scene = scene; this.canvas = byId("drawing");
    byId("drawing-box").hidden = !scene;
  }

  draw(run, k) {
    if (!this.scene || k < 0) return;
    const now = { t: k * run.periodS };
    for (const [name, source] of Object.entries(this.needs)) now[name] = run.place(source)?.values[k] ?? NaN;
    paint(this.canvas, this.scene(now));
  }
}
