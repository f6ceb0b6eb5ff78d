// A phase plane on a canvas: one variable over another. Without a network, as axes.js.

import { axisValues, curveColour, darkPage } from "./axes.js";

// `points`: columns of x and y, the newest last; `names`: of both; `ink`: as plotOptions takes it.
export function drawPhase(canvas, [xs, ys], names, ink) {
  const scale = devicePixelRatio, n = xs.length;
  canvas.width = canvas.clientWidth * scale; canvas.height = canvas.clientHeight * scale;
  if (!n) return;
  const g = canvas.getContext("2d");
  const ends = (of) => {
    let low = Infinity, high = -Infinity;
    for (const v of of) { if (v < low) low = v; if (v > high) high = v; }
    const room = 0.05 * (high - low) || Math.abs(low) || 1;
    return low <= high ? [low - room, high + room] : [-1, 1];
  };
  const [x0, x1] = ends(xs), [y0, y1] = ends(ys);
  const left = 70 * scale, bottom = canvas.height - 46 * scale, top = 8 * scale, right = canvas.width - 8 * scale;
  const at = (i) => [left + (xs[i] - x0) / (x1 - x0) * (right - left), bottom - (ys[i] - y0) / (y1 - y0) * (bottom - top)];
  g.strokeStyle = ink.line(); g.strokeRect(left, top, right - left, bottom - top);
  g.fillStyle = ink.text(); g.font = `${11 * scale}px system-ui`;
  const told = (a, b) => axisValues([a, b], 10 ** (Math.floor(Math.log10(b - a)) - 1)); // a tenth to a hundredth of it
  const [[xa, xb], [ya, yb]] = [told(x0, x1), told(y0, y1)];
  g.fillText(xa, left, bottom + 14 * scale);
  g.textAlign = "right"; g.fillText(xb, right, bottom + 14 * scale);
  g.fillText(ya, left - 4 * scale, bottom); g.fillText(yb, left - 4 * scale, top + 10 * scale);
  g.textAlign = "center"; // below the numbers, in the width that there is
  g.fillText(`${names[1]} over ${names[0]}`, canvas.width / 2, bottom + 32 * scale, canvas.width - 16 * scale);
  g.strokeStyle = curveColour(0, darkPage()); g.lineWidth = scale; g.beginPath();
  for (let i = 0; i < n; i++) g.lineTo(...at(i));
  g.stroke();
  g.fillStyle = curveColour(1, darkPage()); g.beginPath(); g.arc(...at(n - 1), 4 * scale, 0, 7); g.fill();
}
