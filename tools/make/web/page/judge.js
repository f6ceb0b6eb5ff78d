// A run judged in the page as `pcpc simulate` judges it: metrics, limits, requirements.
import { Calculation, span } from "./vectors.js";
import { BARELY, Watch } from "./monitors.js";

const UNFINISHED = "the run did not finish", HERE = "not judged in a page";

// `data`: judge_data of the rig; `column`: NODE:NAME -> Float64Array of at least `cycles` values.
// `met` is null for what was not judged, `words` say why; a metric without `value` has a `why`.
export function judge(data, column, cycles, periodS) {
  const calculation = new Calculation(data, column, cycles, periodS);
  const cut = cycles < data.cycles, reason = cut ? UNFINISHED : data.unjudged;
  const metrics = [];
  for (const about of data.metrics) {
    const found = judgedMetric(about, calculation, reason, periodS);
    if (about.limit || found.why || !Number.isNaN(found.value)) metrics.push(found);
  }
  const requirements = data.requirements.map((one) => required(one, calculation, cut, periodS));
  const limited = metrics.filter((one) => one.limit).sort((a, b) => a.order - b.order);
  const all = [...limited, ...requirements], bad = all.filter((one) => one.met === false);
  const here = all.some((one) => one.here);
  const none = all.length && all.every((one) => one.met === null);
  const word = cut ? UNFINISHED : bad.length ? "expectation not met" : here ? HERE
    : none ? "not judged" : "ok";
  return { word, failed: bad.map((one) => one.words), metrics, requirements,
    signals: drawnSignals(data, calculation) };
}

function judgedMetric(about, calculation, reason, periodS) {
  const { name, unit, order } = about, label = about.id ? `${about.id} ${name}` : name;
  const found = { name, unit, value: NaN };
  const missing = (error) =>
    Object.assign(found, { value: null, why: `${HERE}: ${error}`, here: true });
  if (about.why) missing(about.why);
  try {
    if (!about.why) found.value = calculation.at(about.value);
  } catch (error) {
    missing(error.message);
  }
  if (!about.limit) return found;
  const [low, high] = about.limit.map(Number), value = found.value;
  Object.assign(found, { limit: [low, high], order, met: null });
  if (reason || found.why) {
    return Object.assign(found, { words: `${label}: ${reason || found.why}` });
  }
  const said = Number.isNaN(value) ? "is not known in this run" : `= ${shortNumber(value, 4)}`;
  const limits = `expected ${shortNumber(low, 6)} to ${shortNumber(high, 6)}`;
  const odd = nonFinite(about, calculation, periodS);
  found.met = low <= value && value <= high && !odd;
  found.words = `${label} ${said}, ${limits}`;
  if (odd && low <= value && value <= high) found.words = `${label} ${said} ignores that ${odd}`;
  return found;
}

// The first recorded value of a figure's window that is not finite.
function nonFinite(about, calculation, periodS) {
  const led = calculation.by(about.leader ?? "executive");
  const [first, past] = span(about.window ?? [0, 0], led.cycles);
  for (const [name, variable] of about.asked ?? []) {
    const values = led.recorded(variable).subarray(first, past);
    const bad = values.findIndex((one) => !Number.isFinite(one));
    if (bad >= 0) {
      return `${name} is not a finite number at ${shortNumber((first + bad) * periodS, 4)} s`;
    }
  }
  return "";
}

function required(about, calculation, cut, periodS) {
  const { text } = about;
  const not = (why, here) => ({ text, met: null, margin: null, margin_s: null, first_s: null,
    words: `${text}: not judged: ${why}`, here });
  if (about.missing) return not(`the log has no ${about.missing}`);
  if (about.why) return not(`${HERE}: ${about.why}`, true);
  let watch;
  try {
    watch = new Watch(about, calculation, cut);
  } catch (error) {
    return not(`${HERE}: ${error.message}`, true);
  }
  const { first, least, events, judged } = watch, open = events - judged;
  const time = (cycle) => Number(shortNumber(cycle * periodS, 12));
  if (least === null || !(judged || first)) {
    return { ...not(unjudgedWhy(watch, time)), events, judged, open };
  }
  const margin = Math.abs(watch.margin) <= -BARELY ? 0 : watch.margin / least.factor;
  const found = { text, met: first === null, margin, unit: least.unit, margin_s: time(least.cycle),
    first_s: null, events, judged, open };
  const own = (value, unit) => shortNumber(value, 4) + (unit ? ` ${unit}` : "");
  const smallest = `${own(margin, least.unit)} at ${pythonNumber(found.margin_s)} s`;
  const of = open ? `, ${judged} of ${events} events judged` : "";
  found.words = `${text}: met, margin ${smallest}${of}`;
  if (first) {
    const { what, value, limit, unit } = first;
    Object.assign(found, { first_s: time(first.cycle), what, value, limit });
    const where = `cycle ${first.cycle}, ${pythonNumber(found.first_s)} s: ${what} = ` +
      `${own(value, unit)}, limit ${own(limit, unit)}`;
    found.words = `${text}: violated first at ${where}, smallest margin ${smallest}${of}`;
  }
  return found;
}

function unjudgedWhy({ n, events, about }, time) {
  if (!n) return "its variables were not recorded";
  const past = Number(about.window[1]), begin = Number(about.begin), known = begin < Infinity;
  if (!events && (!known || (about.overshoot && n > begin))) return "its event never happened";
  if ((known && begin >= past) || (about.form === "Hold" && events && n >= past)) {
    return "no cycle lies in its time";
  }
  if (events) return "the run ended before its time was over";
  return `the run ended before its time began, at ${pythonNumber(time(begin))} s`;
}

function drawnSignals(data, calculation) {
  const found = {};
  for (const [name, index] of Object.entries(data.signals)) {
    try {
      found[name] = calculation.vector(index);
    } catch {
      continue; // a variable that the page does not have; its metrics say so
    }
  }
  return found;
}

// A number as Python's format(value, ".{digits}g") writes it.
export function shortNumber(value, digits) {
  if (Number.isNaN(value)) return "nan";
  if (!Number.isFinite(value)) return value > 0 ? "inf" : "-inf";
  let [mantissa, power] = value.toExponential(digits - 1).split("e");
  const [exact, exactPower] = value.toExponential(100).split("e");
  const sign = exact[0] === "-" ? "-" : "";
  const all = exact.replace(/[-.]/g, ""), tie = /^50*$/.test(all.slice(digits));
  if (tie && all[digits - 1] % 2 === 0) { // half to even
    [mantissa, power] = [`${sign}${all[0]}.${all.slice(1, digits)}`, exactPower];
  }
  const trimmed = (text) => (text.includes(".") ? text.replace(/\.?0+$/, "") : text);
  if (power < -4 || power >= digits) {
    return `${trimmed(mantissa)}e${power[0]}${power.slice(1).padStart(2, "0")}`;
  }
  const short = trimmed(Number(`${mantissa}e${power}`).toFixed(Math.max(digits - 1 - power, 0)));
  return Object.is(value, -0) ? "-0" : short;
}

// A number as Python's repr writes it.
export function pythonNumber(value) {
  const [mantissa, power] = value.toExponential().split("e");
  if (value !== 0 && (power < -4 || power >= 16)) {
    return `${mantissa}e${power[0]}${power.slice(1).padStart(2, "0")}`;
  }
  return Number.isInteger(value) ? `${value}.0` : String(value);
}
