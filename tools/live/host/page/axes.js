// What stands beside curves: ticks, ranges, colours, legends, and which curves are shown first. Without
// a network, and without a page but for plotOptions: any page that has uPlot may use it.

const LIGHT = ["#0072b2", "#c04f00", "#00795a", "#b0558a", "#946600", "#1f7fb8", "#6b6b6b", "#7a5195"];
const DARK = ["#56b4e9", "#ff8a3d", "#2fc796", "#e396c4", "#e69f00", "#9ad0f5", "#b0b0b0", "#b79be0"];
const DASHES = [[], [6, 3], [2, 3]];
const MOST_FIRST = { panels: 4, curves: 4 }, AXES = 2;

// Each has a contrast of 3 or more against the page's cards.
export function curveColours(dark) { return dark ? DARK : LIGHT; }
export function curveColour(i, dark) { return curveColours(dark)[i % LIGHT.length]; }
export function darkPage() { return matchMedia("(prefers-color-scheme: dark)").matches; }

// Ticks as text: with as many digits as tell them apart, in a power of ten where those would be many.
export function axisValues(ticks, step) {
  const power = (v) => Math.floor(Math.log10(v) + 1e-9), most = Math.max(step, ...ticks.map(Math.abs));
  const whole = (d) => { const v = step * 10 ** d; return Math.abs(v - Math.round(v)) < 1e-6; };
  let digits = -power(step); // behind the point
  while (!whole(digits) && digits < 2 - power(step)) digits += 1;
  const shift = most < 1e-3 || most >= 1e6 ? power(most) : 0;
  return ticks.map((v) => {
    const text = (v / 10 ** shift).toFixed(Math.min(100, Math.max(0, digits + shift)));
    return +text === 0 ? (shift ? "0" : text.replace("-", "")) : shift ? `${text}e${shift}` : text;
  });
}

// A value as a legend says it.
export function valueText(value, unit) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  return `${value === 0 ? "0" : value.toPrecision(6)}${unit ? ` ${unit}` : ""}`;
}

const shortened = (value) => String(+value.toPrecision(3));

// The range of some columns with some room, null if they have no value: NaN and null are none.
export function rangeOf(columns) {
  let low = Infinity, high = -Infinity;
  for (const column of columns) for (const v of column) if (v !== null) { if (v < low) low = v; if (v > high) high = v; }
  return low <= high ? { low, high } : null;
}

export function roomy({ low, high }) {
  const size = Math.max(Math.abs(low), Math.abs(high));
  const room = high - low > 1e-9 * size ? 0.05 * (high - low) : 0.05 * size || 1;
  return [low - room, high + room];
}

// The same ranges, wider, so that their zeros are at one height. One whose zero is farther off than
// its own width stays as it is: its zero is not in sight.
export function alignedRanges(ranges) {
  const near = ([low, high]) => Math.max(low, -high, 0) <= high - low;
  const zeroed = ranges.map((one) => near(one) ? [Math.min(one[0], 0), Math.max(one[1], 0)] : null);
  const share = zeroed.filter(Boolean).map(([low, high]) => [-low / (high - low), high / (high - low)]);
  if (share.length < 2) return ranges;
  const below = Math.max(...share.map((one) => one[0])), above = Math.max(...share.map((one) => one[1]));
  return zeroed.map((one, i) => {
    if (!one) return ranges[i];
    const each = Math.max(below && -one[0] / below, above && one[1] / above);
    return [-each * below, each * above];
  });
}

// The newest place of each series that has a value; of the first, the time, the newest of all.
export function newestPlaces(data) {
  const places = data.map((column) => {
    let i = column.length - 1;
    while (i >= 0 && (column[i] === null || Number.isNaN(column[i]))) i--;
    return i < 0 ? null : i;
  });
  return [places.slice(1).reduce((a, b) => b === null ? a : Math.max(a ?? b, b), null), ...places.slice(1)];
}

// The legend says the newest values unless the cursor is over the curves.
export function newestLegend(u) {
  if (u.data?.[0]?.length && !(u.cursor.left >= 0)) u.setLegend({ idxs: newestPlaces(u.data) }, false);
}

// Options of uPlot for curves [{ name, unit, label }]. `ink`: text and line, functions of no argument.
// `ranges(units)`: a range a unit; left out, they fit the data. Call newestLegend(u) after setData.
export function plotOptions({ curves, width, height, dark, ink, ranges }) {
  const scale = (unit) => `y ${unit || "1"}`, units = [...new Set(curves.map((one) => one.unit || "1"))];
  const grid = { stroke: ink.line, width: 1 };
  const axis = { stroke: ink.text, grid, ticks: grid, values: (u, found, i, space, step) => axisValues(found, step) };
  const broad = (u, found) => Math.max(56, 20 + 7 * Math.max(0, ...(found ?? []).map((one) => one.length)));
  const fitted = (u) => {
    const own = units.map((unit) => rangeOf(curves.flatMap((one, c) => (one.unit || "1") === unit ? [u.data[c + 1]] : [])));
    return alignedRanges(own.map((one) => one ? roomy(one) : [0, 1]));
  };
  // A scale without an axis of its own is told beside its curves' values.
  const extent = (u, unit) => {
    const { min, max } = units.indexOf(unit || "1") < AXES ? {} : u.scales[scale(unit)];
    return Number.isFinite(min) ? ` (${shortened(min)} to ${shortened(max)} over the height)` : "";
  };
  const found = (u, i) => (ranges ? ranges(units) : fitted(u))[i];
  return {
    width, height, legend: { live: true },
    scales: {
      x: { time: false },
      ...Object.fromEntries(units.map((unit, i) => [scale(unit), { range: (u) => found(u, i) }])),
    },
    axes: [
      { ...axis, space: 75, values: (...its) => axis.values(...its).map((one) => `${one} s`) },
      ...units.slice(0, AXES).map((unit, i) => ({
        ...axis, scale: scale(unit), side: i ? 1 : 3, size: broad, label: units.length > 1 ? unit : undefined,
        labelSize: 16, labelFont: "12px system-ui", grid: i ? { show: false } : grid,
      })),
    ],
    series: [
      { label: "t", value: (u, v) => v === null || v === undefined ? "–" : `${v.toFixed(4)} s` },
      ...curves.map(({ name, unit, label }, i) => ({
        scale: scale(unit), label: label ?? name, stroke: curveColour(i, dark), width: 1.5, spanGaps: false,
        dash: DASHES[Math.floor(i / LIGHT.length) % DASHES.length], points: { show: false },
        value: (u, v) => valueText(v, unit === "calculated" ? "" : unit) + extent(u, unit),
      })),
    ],
    hooks: { setCursor: [newestLegend] },
  };
}

// The panels of a plant that has no layout: errors; then, unit by unit, references with outputs, and
// what the plant is told. `variables`: [{ name, unit, kind, plot }]; a few panels of a few curves.
export function firstPanels(variables) {
  const all = variables.filter((one) => one.plot), outside = (one) => one.name.includes(":");
  const errors = all.filter((one) => one.kind === "output" && /\.e(f?_\w+)?$|error/.test(one.name));
  const references = all.filter((one) => one.kind === "output" && /^(.*:)?reference\./.test(one.name));
  const outputs = all.filter((one) => one.kind === "output" && outside(one) && one.unit && !errors.includes(one));
  const inputs = all.filter((one) => one.kind === "received" && outside(one) && one.unit && /^plant\d*:/.test(one.name));
  const groups = new Map();
  for (const one of [...references.slice(0, 1), ...inputs, ...outputs, ...references]) groups.set(one.unit, []);
  for (const [unit, group] of groups) {
    const of = (list) => list.filter((one) => one.unit === unit);
    group.push(...new Set([...of(references).slice(0, 2), ...of(inputs).slice(0, 2), ...of(outputs)]));
  }
  const panels = [errors, ...groups.values()].filter((one) => one.length).slice(0, MOST_FIRST.panels);
  const shown = panels.length ? panels : all.length ? [all] : [[]];
  return shown.map((group) => ({ kind: "time", names: group.slice(0, MOST_FIRST.curves).map((one) => one.name) }));
}
