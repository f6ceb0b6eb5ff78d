// What is seen of a run: curves over time.
import { darkPage, newestLegend, plotOptions } from "./axes.js";

const BINS = 600, HEIGHT = 190;

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
    this.names = names; this.box = box.appendChild(element("div", "", { class: "panel", role: "group" }));
    this.plot = null;
  }

  shown(run) {
    this.places = this.names.map((name) => [name, run.place(name)]).filter(([, place]) => place);
    this.run = run;
    this.plot?.destroy();
    this.plot = null;
    this.box.hidden = !this.places.length;
    if (this.box.hidden) return;
    this.box.setAttribute("aria-label", `curves: ${this.places.map(([name]) => name).join(", ")}`);
    const curves = this.places.map(([name, { unit }]) => ({ name, unit }));
    const ink = { text: () => css("--text"), line: () => css("--line") };
    const options = plotOptions({ curves, width: this.box.clientWidth - 8, height: HEIGHT, dark: darkPage(), ink });
    this.plot = new uPlot(options, [[], ...curves.map(() => [])], this.box);
  }

  draw(windowS) {
    if (!this.plot) return;
    const last = this.run.done, period = this.run.periodS;
    let first = Math.max(0, last - Math.round(windowS / period));
    const width = Math.max(1, Math.ceil((last - first) / BINS));
    first -= first % width; // bins stay where they are while time goes on
    const x = [];
    for (let k = first; k < last; k += width) { x.push(k * period); if (width > 1) x.push((k + 0.5 * width) * period); }
    this.plot.setData([x, ...this.places.map(([, place]) => envelope(place.values, first, last, width))], true);
    newestLegend(this.plot);
  }

  resize() { this.plot?.setSize({ width: this.box.clientWidth - 8, height: HEIGHT }); }
}
