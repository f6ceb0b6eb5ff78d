// A plant's scene of an instant, of what scene_script.py has written down of its drawing.py.
import { pythonNumber, shortNumber } from "./judge.js";
import { NUMBER_OPERATIONS } from "./vectors.js";

const FAR = 50; // of the bounds; what is drawn beyond is cut: plants/scene.py
const OPERATIONS = {
  ...NUMBER_OPERATIONS, copysign: (a, b) => (b < 0 || Object.is(b, -0) ? -Math.abs(a) : Math.abs(a)),
};

// A number as Python's format(value, spec) writes it, for the formats of scene_script.py.
function formatted(value, spec) {
  const [, plus, , digits, kind] = /^(\+?)(\.(\d+))?([gfe]?)$/.exec(spec), sign = plus && value >= 0 ? "+" : "";
  if (!kind) return pythonNumber(value);
  if (kind === "g" || !Number.isFinite(value)) return sign + shortNumber(value, Math.max(1, +(digits ?? 6)));
  if (kind === "f") return sign + value.toFixed(+(digits ?? 6));
  const [mantissa, power] = value.toExponential(+(digits ?? 6)).split("e");
  return `${sign}${mantissa}e${power[0]}${power.slice(1).padStart(2, "0")}`;
}

class Instant {
  constructor(data, now, settings) { Object.assign(this, { data, now, settings, made: new Map() }); }

  node(index) {
    if (!this.made.has(index)) this.made.set(index, this.calculated(...this.data.nodes[index]));
    return this.made.get(index);
  }

  calculated(word, ...given) {
    if (word === "number") return Number(given[0]);
    if (word === "now") return this.now[given[0]];
    if (word === "setting") return this.settings[given[0]];
    return OPERATIONS[word](...given.map((one) => this.node(one)));
  }

  number(told) { return Array.isArray(told) ? this.node(told[0]) : Number(told); }

  words(told) {
    return told.map((one) => (typeof one === "string" ? one : formatted(this.node(one[0]), one[1]))).join("");
  }

  leaf() {
    let tree = this.data.tree;
    while (tree.if !== undefined) tree = this.node(tree.if) !== 0 ? tree.yes : tree.no;
    return tree;
  }

  shape(index) {
    const [kind, role, xy, size, style] = this.data.shapes[index];
    const sized = kind === "text" ? this.words(size) : this.number(size);
    return [kind, role, xy.map((one) => this.number(one)), sized, Array.isArray(style) ? this.node(style[0]) : style];
  }

  // The settings that the drawing does not follow.
  unfollowed() {
    const other = this.data.assumed.filter(([index, value]) => this.node(index) !== Number(value));
    return [...new Set(other.flatMap(([, , names]) => names))];
  }
}

// The scene as plants/drawing.py's Drawing.scene has it. `given`: values by short name, and t;
// `changed`: settings that are not the rig's; `begun`: whether a value that is not known is told.
export function sceneOf(data, given, changed = {}, begun = true) {
  const names = Object.keys(data.needs);
  const known = (name) => (Number.isFinite(given[name]) ? given[name] : NaN);
  const now = Object.fromEntries([...names, "t"].map((name) => [name, known(name)]));
  const settings = Object.fromEntries(Object.entries(data.settings).map(([name, value]) => [name, changed[name] ?? Number(value)]));
  let instant = new Instant(data, now, settings);
  const unfollowed = instant.unfollowed();
  if (unfollowed.length) {
    const own = Object.fromEntries(unfollowed.filter((name) => name in data.settings).map((name) => [name, Number(data.settings[name])]));
    instant = new Instant(data, now, { ...settings, ...own });
  }
  const leaf = instant.leaf();
  if (leaf.error !== undefined) {
    return { bounds: [-1, -1, 1, 1], note: "", shapes: [["text", "note", [0, 0], leaf.error, "middle"]] };
  }
  const [x0, y0, x1, y1] = leaf.bounds.map((one) => instant.number(one)), side = Math.max(x1 - x0, y1 - y0);
  const all = leaf.shapes.map((index) => instant.shape(index));
  const shapes = all.filter(([, , xy]) => xy.every(Number.isFinite));
  const absent = names.filter((name) => Number.isNaN(now[name]));
  const say = (text, below) => shapes.push(["text", "note", [0.5 * (x0 + x1), y1 - below * side], text, "middle"]);
  if (begun && (absent.length || shapes.length < all.length)) say(["no data", absent.join(", ")].filter(Boolean).join(": "), 0.04);
  if (unfollowed.length) say(`drawn with the rig's own ${unfollowed.join(", ")}`, 0.09);
  const near = (value) => Math.max(-FAR * side, Math.min(FAR * side, value));
  return {
    bounds: [x0, y0, x1, y1], note: instant.words(leaf.note),
    shapes: shapes.map(([kind, role, xy, size, style]) => [kind, role, xy.map(near), size, style]),
  };
}
