// Numbers a cycle, and figures of merit of them, as numpy and plants/statistics.py calculate them.

export const NUMBER_OPERATIONS = {
  absolute: Math.abs, negative: (x) => -x, positive: (x) => x, sign: Math.sign, sqrt: Math.sqrt,
  square: (x) => x * x, cbrt: Math.cbrt, exp: Math.exp, expm1: Math.expm1, log: Math.log,
  log1p: Math.log1p, log2: Math.log2, log10: Math.log10, sin: Math.sin, cos: Math.cos,
  tan: Math.tan, arcsin: Math.asin, arccos: Math.acos, arctan: Math.atan, sinh: Math.sinh,
  cosh: Math.cosh, tanh: Math.tanh, floor: Math.floor, ceil: Math.ceil, trunc: Math.trunc,
  rint: (x) => {
    const low = Math.floor(x);
    if (x - low !== 0.5) return Math.round(x);
    return low % 2 === 0 ? low : low + 1;
  },
  isfinite: (x) => +Number.isFinite(x), isnan: (x) => +Number.isNaN(x),
  isinf: (x) => +(Math.abs(x) === Infinity), logical_not: (x) => +(x === 0),
  deg2rad: (x) => x * (Math.PI / 180), rad2deg: (x) => x * (180 / Math.PI),
  add: (a, b) => a + b, subtract: (a, b) => a - b, multiply: (a, b) => a * b,
  divide: (a, b) => a / b,
  power: (a, b) => (a === 1 || (a === -1 && Math.abs(b) === Infinity) ? 1 : a ** b),
  remainder: (a, b) => {
    const left = a % b;
    return left !== 0 && left < 0 !== b < 0 ? left + b : left;
  },
  maximum: Math.max, minimum: Math.min, hypot: Math.hypot, arctan2: Math.atan2,
  fmax: (a, b) => (a >= b || Number.isNaN(b) ? a : b),
  fmin: (a, b) => (a <= b || Number.isNaN(b) ? a : b),
  less: (a, b) => +(a < b), less_equal: (a, b) => +(a <= b), greater: (a, b) => +(a > b),
  greater_equal: (a, b) => +(a >= b), equal: (a, b) => +(a === b),
  not_equal: (a, b) => +(a !== b), logical_and: (a, b) => +(a !== 0 && b !== 0),
  logical_or: (a, b) => +(a !== 0 || b !== 0),
  logical_xor: (a, b) => +((a !== 0) !== (b !== 0)),
  where: (condition, yes, no) => (condition !== 0 ? yes : no),
};

// The sum of numpy, in its order: the last bits are the same.
export function pairwiseSum(x, begin = 0, n = x.length) {
  if (n < 8) {
    let sum = 0;
    for (let i = 0; i < n; i++) sum += x[begin + i];
    return sum;
  }
  if (n > 128) {
    let half = n >> 1;
    half -= half % 8;
    return pairwiseSum(x, begin, half) + pairwiseSum(x, begin + half, n - half);
  }
  const r = x.slice(begin, begin + 8);
  let i = 8;
  for (; i < n - (n % 8); i += 8) for (let j = 0; j < 8; j++) r[j] += x[begin + i + j];
  let sum = r[0] + r[1] + (r[2] + r[3]) + (r[4] + r[5] + (r[6] + r[7]));
  for (; i < n; i++) sum += x[begin + i];
  return sum;
}

const meanOf = (x) => pairwiseSum(x) / x.length;
const squares = (x, centre) => x.map((one) => (one - centre) * (one - centre));
const greatest = (x) => x.reduce((a, b) => Math.max(a, b), -Infinity);
const overFinite = (statistic) => (x) => {
  const finite = x.filter(Number.isFinite);
  return finite.length ? statistic(finite) : NaN;
};

function medianOf(x) {
  const sorted = x.slice().sort(), half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
}

function correlationOf([a, b]) {
  if (a.length < 2) return NaN;
  const [x, y] = [a, b].map((one) => {
    const mean = meanOf(one);
    return one.map((value) => value - mean);
  });
  const product = (p, q) => pairwiseSum(p.map((value, i) => value * q[i]));
  const [xx, xy, yy] = [product(x, x), product(x, y), product(y, y)];
  return xx > 0 && yy > 0 ? Math.min(1, Math.max(-1, xy / Math.sqrt(xx) / Math.sqrt(yy))) : NaN;
}

function settlingOf([seen, outside]) {
  let last = -Infinity, lastOutside = -Infinity;
  seen.forEach((time, i) => {
    if (!Number.isFinite(time)) return;
    last = Math.max(last, time);
    if (outside[i] > 0) lastOutside = Math.max(lastOutside, time);
  });
  if (last === -Infinity) return NaN;
  return lastOutside === last ? Infinity : Math.max(lastOutside, 0);
}

export const STATISTICS = {
  RMS: overFinite((x) => Math.sqrt(meanOf(squares(x, 0)))),
  PEAK: overFinite((x) => greatest(x.map(Math.abs))),
  LOW: overFinite((x) => -greatest(x.map((one) => -one))),
  HIGH: overFinite(greatest),
  SUM: overFinite((x) => pairwiseSum(x)),
  COUNT: (x) => x.filter(Number.isFinite).length,
  MEAN: overFinite(meanOf),
  STD: overFinite((x) => Math.sqrt(meanOf(squares(x, meanOf(x))))),
  MEDIAN: overFinite(medianOf),
  LAST: (x) => (x.length ? x[x.length - 1] : NaN),
  CORRELATION: correlationOf,
  SETTLING: settlingOf,
};

// The nodes of a trace (symbols.py) over the columns of a run, each calculated once.
// `leader`: the node whose cycles count; all but the executive record a few more than `cycles`.
export class Calculation {
  constructor(data, column, cycles, periodS, leader = "executive", whole = null) {
    Object.assign(this, { data, column, cycles, periodS, leader, made: new Map(), led: new Map() });
    this.whole = whole ?? this;
    if (whole !== null) {
      const owned = ([word, name]) => word === "column" && name.startsWith(`${leader}:`);
      const own = data.nodes.find(owned);
      this.cycles = own ? this.recorded(own[1]).length : cycles;
    }
    const [first, past] = span(data.reach, this.cycles);
    this.reached = first < past;
  }

  // The same by the cycles of another node.
  by(leader) {
    const { data, column, cycles, periodS, whole, led } = this.whole;
    if (leader === whole.leader) return whole;
    if (!led.has(leader)) {
      led.set(leader, new Calculation(data, column, cycles, periodS, leader, whole));
    }
    return led.get(leader);
  }

  // A number for all cycles, a Float64Array of one for each, or two of those.
  at(index) {
    if (!this.made.has(index)) this.made.set(index, this.calculated(...this.data.nodes[index]));
    return this.made.get(index);
  }

  vector(index) {
    const found = this.at(index);
    return typeof found === "number" ? new Float64Array(this.cycles).fill(found) : found;
  }

  calculated(word, ...given) {
    if (word === "number") return Number(given[0]);
    if (word === "cycle") return Float64Array.from({ length: this.cycles }, (_, i) => i);
    if (word === "column") return this.paired(given[0]);
    if (word === "told") return this.told(given[0]);
    if (word === "if") return this.at(given[this.at(given[0]) !== 0 ? 1 : 2]);
    if (word === "columns") return given.map((one) => this.vector(one));
    if (word === "merit") return this.by(given[0]).figure(...given.slice(1));
    if (word === "before" || word === "after" || word === "rate") {
      return this.moved(word, this.vector(given[0]), this.cycles);
    }
    const act = NUMBER_OPERATIONS[word], parts = given.map((one) => this.at(one));
    if (act === undefined) throw new Error(`no operation ${word}`);
    if (parts.every((one) => typeof one === "number")) return act(...parts);
    const [a, b, c] = given.map((one) => this.vector(one)), found = new Float64Array(this.cycles);
    for (let i = 0; i < found.length; i++) {
      found[i] = !b ? act(a[i]) : !c ? act(a[i], b[i]) : act(a[i], b[i], c[i]);
    }
    return found;
  }

  recorded(name) {
    const found = this.column(name);
    if (found === undefined) throw new Error(`the page has no ${name}`);
    return name.startsWith("executive:") ? found.subarray(0, this.whole.cycles) : found;
  }

  // A variable at the leader's cycles.
  paired(name) {
    const found = this.recorded(name).subarray(0, this.cycles);
    if (found.length === this.cycles) return found;
    const padded = new Float64Array(this.cycles).fill(NaN);
    padded.set(found);
    return padded;
  }

  told(node) {
    const found = new Float64Array(this.cycles).fill(1);
    return node === "executive" ? found.fill(0, this.whole.cycles) : found;
  }

  moved(word, x, n) {
    const found = new Float64Array(n).fill(word === "rate" ? 0 : NaN);
    if (word === "before") found.set(x.subarray(0, Math.max(n - 1, 0)), Math.min(n, 1));
    if (word === "after") found.set(x.subarray(1));
    if (word === "rate") for (let i = 1; i < n; i++) found[i] = (x[i] - x[i - 1]) / this.periodS;
    return found;
  }

  figure(name, source, ...window) {
    if (!this.reached) return NaN;
    const [first, past] = span(window, this.cycles), found = this.at(source);
    const cut = (x) => x.subarray(first, past);
    return STATISTICS[name](Array.isArray(found) ? found.map(cut) : cut(this.vector(source)));
  }
}

// A window's cycles of those that there are: the first, and the first behind it.
export function span(window, cycles) {
  const [first, past] = window.map((one) => Math.min(Math.max(Number(one), 0), cycles));
  return [first, Math.max(first, past)];
}
