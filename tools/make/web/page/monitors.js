// Requirements of a whole run, as tools/after/verdict/monitors.py judges them: its (1), (2), (3).

export const BARELY = -2.2250738585072014e-308; // a margin of 0 of what does not hold
const COMPARED = {
  "<": (a, b) => a < b, "<=": (a, b) => a <= b, ">": (a, b) => a > b, ">=": (a, b) => a >= b,
  "==": (a, b) => a === b, "!=": (a, b) => a !== b,
};

// One requirement of judge_data over a run that is over, or `cut`.
export class Watch {
  constructor(about, calculation, cut) {
    Object.assign(this, { about, calculation, cut, n: calculation.cycles, made: {} });
    Object.assign(this, { margin: Infinity, least: null, first: null, events: 0, judged: 0 });
    const event = this.begins();
    if (about.overshoot) this.shoot(event, about.overshoot);
    this.starts = [];
    event.forEach((begins, i) => begins && this.starts.push(i));
    this.events = this.starts.length;
    if (this.n) this[about.form.toLowerCase()](this.margins(about.holds));
  }

  values(index) {
    return typeof index === "string" ? this.made[index] : this.calculation.vector(index);
  }

  // The margin of a condition in each cycle; negative exactly where it does not hold.
  margins(condition) {
    if (condition.word) {
      const pick = condition.word === "and" ? Math.min : Math.max;
      const parts = condition.of.map((one) => this.margins(one));
      return parts[0].map((_, i) => pick(...parts.map((one) => one[i])));
    }
    const { sign, a, b } = condition, y = this.values(b), holds = COMPARED[sign];
    return this.values(a).map((x, i) => {
      if (Number.isNaN(x) || Number.isNaN(y[i])) return -Infinity;
      const far = Math.abs(x - y[i]) || 0; // of equal infinities
      if (holds(x, y[i])) return sign === "==" ? 0 : far;
      return Math.min(-far, BARELY);
    });
  }

  // The comparison that decided in cycle i.
  said(condition, i) {
    if (condition.word) {
      const margins = condition.of.map((one) => this.margins(one)[i]);
      const best = (condition.word === "and" ? Math.min : Math.max)(...margins);
      return this.said(condition.of[margins.indexOf(best)], i);
    }
    const { what, factor, unit } = condition;
    const [value, limit] = [condition.value, condition.limit].map((one) => this.values(one)[i]);
    return { what, value: value / factor, limit: limit / factor, unit, factor };
  }

  // Where an obligation begins.
  begins() {
    const { about, n } = this, [first, past] = about.window.map(Number);
    let found = new Array(n).fill(false);
    if (about.becomes) {
      const margin = this.margins(about.becomes);
      found = found.map((_, i) => margin[i] >= 0 && !(i && margin[i - 1] >= 0));
    } else if (about.changes !== undefined) {
      const x = this.values(about.changes), isNaN = Number.isNaN;
      found = found.map((_, i) => i > 0 && x[i] !== x[i - 1] && !(isNaN(x[i]) && isNaN(x[i - 1])));
    } else {
      found[about.begin] = about.begin < n;
      found.length = n;
    }
    return found.map((begins, i) => begins && i >= first && i < past);
  }

  shoot(event, shot) {
    const x = this.values(shot.value), over = this.values(shot.over);
    const past = new Float64Array(this.n), limit = new Float64Array(this.n);
    let step = NaN;
    for (let i = 0; i < this.n; i++) {
      const jump = over[i] - over[Math.max(i - 1, 0)];
      event[i] = event[i] && Number.isFinite(jump) && jump !== 0;
      if (event[i]) step = jump;
      past[i] = Math.sign(step) * (x[i] - over[i]);
      limit[i] = shot.relative ? shot.limit * Math.abs(step) : shot.limit;
    }
    this.made = { "past the reference": past, limit };
  }

  note(i, margin, condition) {
    this.margin = margin;
    this.least = { cycle: i, ...this.said(condition, i) };
  }

  violate(i, condition) {
    if (this.first === null || i < this.first.cycle) {
      this.first = { cycle: i, ...this.said(condition, i) };
    }
  }

  hold(margin) { // (1)
    const { about, n, starts } = this, past = Number(about.window[1]);
    let since = -1, next = 0, counted = -1, least = -1, bad = -1, low = Infinity;
    for (let i = 0; i < n; i++) {
      if (starts[next] === i) since = starts[next++];
      if (since < 0 || i - since < about.within || i >= past) continue;
      if (since !== counted) this.judged++;
      counted = since;
      if (margin[i] < low) [low, least] = [margin[i], i];
      if (margin[i] < 0 && bad < 0) bad = i;
    }
    if (counted < 0) return;
    this.note(Math.max(least, 0), low, about.holds);
    if (bad >= 0) this.violate(bad, about.holds);
    const unfinished = past === Infinity ? this.cut : n < past;
    if (unfinished && counted === since && this.first === null) this.judged--;
  }

  respond(margin) { // (2)
    const { within, lasts, holds } = this.about, last = this.n - 1;
    const over = extremes(margin, lasts, Math.min);
    const hoped = extremes(over, within, Math.max);
    const whole = over.map((one, i) => (i + lasts <= last ? one : -Infinity));
    const sure = extremes(whole, within, Math.max);
    let low = Infinity, least = -1;
    for (const at of this.starts) {
      const held = sure[at] >= 0, broken = !held && hoped[at] < 0 && at + within <= last;
      if (!held && !broken) continue;
      this.judged++;
      const found = held ? sure[at] : hoped[at];
      if (least < 0 || found < low) [low, least] = [found, at];
      if (broken) {
        this.violate(margin.findIndex((one, i) => i >= at + within && one < 0), holds);
      }
    }
    if (least >= 0) this.note(Math.max(margin.indexOf(low, least), least), low, holds);
  }

  until(kept) { // (3)
    const { about, n, starts } = this, { holds, until } = about;
    if (!starts.length) return;
    const ends = this.margins(until), due = about.ends ? starts[0] + about.within : Infinity;
    let before = Infinity, best = -Infinity, least = -1, done = false, bad = -1;
    for (let i = starts[0]; i < n && i <= due; i++) {
      const found = Math.min(ends[i], before);
      if (found > best || least < 0) [best, least] = [found, i];
      done ||= found >= 0 && bad < 0;
      if (kept[i] < 0 && bad < 0 && !done) bad = i;
      before = Math.min(before, kept[i]);
    }
    if (bad >= 0) this.violate(bad, holds);
    if (n - 1 >= due && !done && bad < 0) this.violate(due, until);
    this.judged = +(done || this.first !== null);
    if (this.judged) this.note(least, best, ends[least] === best ? until : holds);
  }
}

// The extreme over [i, i + reach], as far as there are values, for each i.
function extremes(values, reach, pick) {
  const found = new Float64Array(values.length), queue = [];
  for (let i = values.length - 1, head = 0; i >= 0; i--) {
    while (queue.length > head && pick(values[i], values[queue[queue.length - 1]]) === values[i]) {
      queue.pop();
    }
    queue.push(i);
    if (queue[head] > i + reach) head++;
    found[i] = values[queue[head]];
  }
  return found;
}
