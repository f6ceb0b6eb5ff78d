// Paints a plant's scene, shapes in the plant's lengths (plants/scene.py), on a canvas.

import { css } from "./panels.js";

const FONT = 13, ROOM = 12;

export function paint(canvas, scene) {
  const scale = devicePixelRatio, [x0, y0, x1, y1] = scene.bounds;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  const high = height - (scene.note ? 1.3 * FONT : 0); // the note lies below what is drawn
  const each = Math.min((width - 2 * ROOM) / (x1 - x0), (high - 2 * ROOM) / (y1 - y0));
  if (!(each > 0)) return; // no room: it is folded, or not laid out yet
  const left = 0.5 * (width - each * (x1 - x0)), top = 0.5 * (high - each * (y1 - y0));
  const pixels = [Math.round(width * scale), Math.round(height * scale)];
  if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) [canvas.width, canvas.height] = pixels;
  const g = canvas.getContext("2d");
  g.setTransform(scale, 0, 0, scale, 0, 0);
  g.clearRect(0, 0, width, height);
  g.lineJoin = g.lineCap = "round";
  const x = (value) => left + (value - x0) * each, y = (value) => top + (y1 - value) * each;
  const path = (xy) => {
    g.beginPath();
    for (let i = 0; i + 1 < xy.length; i += 2) g.lineTo(x(xy[i]), y(xy[i + 1]));
  };
  const filled = (fill) => { g.globalAlpha = fill; g.fill(); g.globalAlpha = 1; };
  for (const [kind, role, xy, size, style] of scene.shapes) {
    g.strokeStyle = g.fillStyle = css(`--role-${role}`) || css("--text");
    if (kind === "text") {
      g.font = `${FONT}px system-ui`; g.textBaseline = "middle";
      g.textAlign = style === "middle" ? "center" : style;
      const wide = g.measureText(size).width, ahead = style === "middle" ? 0.5 * wide : style === "end" ? wide : 0;
      g.fillText(size, Math.min(Math.max(x(xy[0]), ahead + 2), width - wide + ahead - 2), y(xy[1]));
      continue;
    }
    g.lineWidth = size; g.setLineDash(kind === "line" && style ? [6, 4] : []);
    if (kind === "disc") {
      g.beginPath(); g.arc(x(xy[0]), y(xy[1]), xy[2] * each, 0, 7);
    } else path(xy);
    if (kind === "area") g.closePath();
    if (kind !== "line") filled(style);
    g.stroke();
  }
  g.setLineDash([]);
  if (scene.note) {
    g.font = `${FONT}px system-ui`; g.fillStyle = css("--quiet"); g.textAlign = "right"; g.textBaseline = "bottom";
    const lines = [];
    for (const part of scene.note.split("; ")) { // a narrow page has more lines
      const longer = lines.length ? `${lines.at(-1)}; ${part}` : part;
      if (lines.length && g.measureText(longer).width < width - 8) lines[lines.length - 1] = longer;
      else lines.push(part);
    }
    lines.reverse().forEach((one, i) => g.fillText(one, width - 4, height - 2 - 1.3 * FONT * i));
  }
}
