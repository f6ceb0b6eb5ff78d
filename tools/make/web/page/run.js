// A run as the page keeps it: a column a variable, and the digest of all of them.
const DIGESTED = 1, MUST_BE_FINITE = 2;
const FINITE = 1e300; // from here on a value counts as not finite: executive/loop/limits.py
const NAN_BITS = 0x7ff8000000000000n;

// What several controllers have is there once.
const unshared = (value, parts) => (Array.isArray(value) ? value.map((one) => unshared(one, parts))
  : value?.part !== undefined ? parts[value.part] : value);

export async function contents(text) {
  const packed = Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const whole = await new Response(stream).arrayBuffer();
  const length = new DataView(whole).getUint32(0, true);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(whole, 4, length)));
  for (const one of about.controllers) {
    one.log = Object.fromEntries(Object.entries(one.log).map(([key, value]) => [key, unshared(value, about.parts)]));
  }
  return { about, module: ([offset, bytes]) => whole.slice(4 + length + offset, 4 + length + offset + bytes) };
}

export class Run {
  constructor(controller, nodes, periodS) {
    this.controller = controller; this.nodes = nodes; this.periodS = periodS; this.cycles = controller.cycles;
    // The lower nodes do one cycle more than the executive.
    this.kept = nodes.map((node) => controller.columns[node].map(() => new Float64Array(this.cycles + 1).fill(NaN)));
    this.counts = nodes.map(() => 0);
    this.cursor = Infinity; // up to which cycle a log has played
    this.places = new Map();
    nodes.forEach((node, i) => controller.columns[node].forEach(([name, unit, help, , kind], j) => {
      this.places.set(`${node}:${name}`, { name, unit, help, kind, values: this.kept[i][j], count: () => this.counts[i] });
    }));
  }

  take(parts) {
    parts.forEach((rows, i) => {
      const columns = this.kept[i], n = columns.length;
      if (!n) return;
      const first = this.counts[i], count = Math.min(rows.length / n, this.cycles + 1 - first);
      for (let j = 0; j < n; j++) for (let r = 0; r < count; r++) columns[j][first + r] = rows[r * n + j];
      this.counts[i] += count;
    });
  }

  // A log in the place of what is computed; what none records stays unknown.
  fill({ cycles, columns }) {
    this.nodes.forEach((node, i) => {
      this.controller.columns[node].forEach(([name], j) => {
        const found = columns[`${node}:${name}`];
        if (found) this.kept[i][j].set(found.subarray(0, this.cycles + 1));
      });
      this.counts[i] = cycles + (i > 0);
    });
    this.cursor = 0;
  }

  // A name as in a log: NODE:NAME, or NAME alone: the executive's, else of the node that has it.
  place(name) {
    if (name.includes(":")) return this.places.get(name);
    return this.nodes.map((node) => this.places.get(`${node}:${name}`)).find(Boolean);
  }

  // All that was recorded of NODE:NAME.
  record(name) {
    const found = this.places.get(name);
    return found?.values.subarray(0, found.count());
  }

  // The first value that is a fault natively, {name, cycle}, or null.
  odd() {
    let first = null;
    this.nodes.forEach((node, i) => this.controller.columns[node].forEach((one, j) => {
      if (!(one[3] & MUST_BE_FINITE)) return;
      const end = Math.min(this.counts[i], first?.cycle ?? Infinity), values = this.kept[i][j];
      for (let k = 0; k < end; k++) if (!(Math.abs(values[k]) < FINITE)) { first = { name: `${node}:${one[0]}`, cycle: k }; break; }
    }));
    return first;
  }

  get done() { return Math.min(this.cycles, this.cursor, ...this.counts.filter((_, i) => this.kept[i].length)); }

  async digest() {
    const widths = this.nodes.map((node) => this.controller.columns[node].filter((one) => one[3] & DIGESTED).length);
    const whole = new Float64Array(this.cycles * widths.reduce((a, b) => a + b, 0));
    const bits = new BigUint64Array(whole.buffer);
    let base = 0;
    this.nodes.forEach((node, i) => {
      const width = widths[i];
      let place = 0;
      this.controller.columns[node].forEach((one, j) => {
        if (!(one[3] & DIGESTED)) return;
        for (let k = 0, values = this.kept[i][j]; k < this.cycles; k++) {
          whole[base + k * width + place] = values[k];
          if (values[k] !== values[k]) bits[base + k * width + place] = NAN_BITS;
        }
        place += 1;
      });
      base += width * this.cycles;
    });
    const found = new Uint8Array(await crypto.subtle.digest("SHA-256", whole.buffer));
    return Array.from(found, (byte) => byte.toString(16).padStart(2, "0")).join("");
  }
}
