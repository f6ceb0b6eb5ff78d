// Elements of the page, and values as text and as points.

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

// Points of curves over the cycles [first, last): of each `width` cycles the least and the greatest
// value in their order, so that no spike is lost, and at the end the newest value. [x, y, y, ...]
export function curvePoints(columns, first, last, width, periodS) {
  const x = [], curves = columns.map(() => []);
  for (let k = first; k < last; k += width) {
    const end = Math.min(k + width, last);
    x.push(k * periodS);
    if (width > 1) x.push(Math.min(k + 0.5 * width, end - 1) * periodS);
    columns.forEach((values, c) => {
      let low = k, high = k;
      for (let i = k; i < end; i++) {
        if (values[i] < values[low] || Number.isNaN(values[low])) low = i;
        if (values[i] > values[high] || Number.isNaN(values[high])) high = i;
      }
      curves[c].push(values[Math.min(low, high)]);
      if (width > 1) curves[c].push(values[Math.max(low, high)]);
    });
  }
  if (width > 1 && last > first) {
    x.push((last - 1) * periodS);
    columns.forEach((values, c) => curves[c].push(values[last - 1]));
  }
  return [x, ...curves];
}
