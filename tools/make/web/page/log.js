// A run as a native log, and a native log as a run: see tools/make/web/log_head.py.
import { McapWriter, Messages, mcapContents, textMessage } from "./mcap.js";
import { Exchange } from "./frames.js";
const LOG_BYTES = 200e6, BATCH_CYCLES = 500, CDR_HEADER = 0x100, NAN_WORD = 0x7ff8000000000000n;
const topicOf = (node, kind) => (node === "executive" ? `/${kind}` : `/${node}/${kind}`);
const infinite = { inf: Infinity, "-inf": -Infinity };

function stepped(steps, cycle) {
  let value = 0;
  for (const [from, next] of steps) if (from <= cycle) value = next;
  return infinite[value] ?? value;
}

// What a recorded variable of a node is in a cycle.
class Values {
  constructor(head, run) {
    this.nodes = head.nodes.map((about) => ({ about, columns: new Map(), known: new Set(about.state) }));
    this.head = head; this.run = run;
  }

  at(i, name, cycle) {
    const { about, columns, known } = this.nodes[i];
    if (name === "time.t_s") return cycle * this.head.period_s;
    if (about.steps[name]) return stepped(about.steps[name], cycle);
    if (!known.has(name)) return undefined;
    if (!columns.has(name)) {
      const found = this.run.column(`${about.name}:${name}`);
      if (!found || found.length < this.run.cycles + (i > 0)) {
        throw new Error(`${about.name}:${name}: the run has no such column up to its last cycle`);
      }
      columns.set(name, found);
    }
    return columns.get(name)[cycle];
  }
}

// The longest absence of each id heard, in cycles: executive/log/run_counts.py.
class Away {
  constructor() { this.last = new Map(); this.longest = new Map(); }

  hear(word, cycle) {
    this.longest.set(word, Math.max(this.longest.get(word) ?? 0, cycle - (this.last.get(word) ?? 0)));
    this.last.set(word, cycle);
  }

  entries(cycles) {
    const words = [...this.last.keys()].sort((a, b) => a - b);
    return words.map((id) => [hex(id), String(Math.max(this.longest.get(id), cycles - this.last.get(id)))]);
  }
}

const attachedBytes = (text) => (text.startsWith("base64:")
  ? Uint8Array.from(atob(text.slice(7)), (letter) => letter.charCodeAt(0)) : new TextEncoder().encode(text));
const hex = (id) => id.toString(16).toUpperCase();

class LogOfRun {
  constructor(head, run, wallNs) {
    this.head = head; this.run = run; this.wall = BigInt(wallNs);
    this.values = new Values(head, run);
    this.ids = new Map(head.channels.map(([id, , topic]) => [topic, id]));
    this.writer = new McapWriter(head);
    this.nodes = head.nodes.map((about, i) => ({
      about, i, rows: 0, events: 0, frames: 0, counts: new Map(), away: new Away(), pending: [],
      entries: this.entries(about, i),
    }));
    this.exchange = new Exchange(head, (i, name, k) => this.values.at(i, name, k), (...one) => this.note(...one));
  }

  entries(about, i) {
    const own = (one) => one.node === about.name;
    const settings = Object.entries(this.run.settings ?? {}).map(([name, value]) => {
      const [node, variable] = name.split(/:(.*)/s);
      return { cycle: 0, node, name: variable, value };
    });
    const tunings = [...this.head.tunings, ...settings, ...(this.run.tunings ?? [])].filter(own);
    const events = about.events.map((event) => ({ topic: "events", ...event }));
    const last = this.run.cycles + (i > 0);
    return [...tunings.map(({ cycle, name, value }) => ({ topic: "tunings", cycle, name, value })), ...events]
      .filter((one) => one.cycle < last).sort((a, b) => a.cycle - b.cycle);
  }

  stamp(cycle) { return this.wall + BigInt(cycle) * BigInt(this.head.period_ns); }

  note(i, cycle, { frame, data }, received) {
    const node = this.nodes[i], size = node.about.data_bytes;
    node.pending.at(-1)?.cycle === cycle || node.pending.push({ cycle, frames: [] });
    node.pending.at(-1).frames.push({ frame, data, received, size });
    const key = (received ? 2 ** 40 : 0) + frame.word;
    node.counts.set(key, (node.counts.get(key) ?? 0) + 1);
    node.frames += 1;
    if (received && cycle < this.run.cycles + (i > 0)) node.away.hear(frame.word, cycle);
  }

  heads() {
    const { head, writer } = this, wall = String(this.wall);
    for (const [name, entries] of head.metadata) {
      const its = "clock_wall_ns" in entries ? { ...entries, clock_wall_ns: wall } : entries;
      writer.metadata(name, its);
    }
    for (const [name, kind, text] of head.attachments) {
      let data = attachedBytes(text);
      if (head.nodes.some((node) => name === `${node.name}.json`)) {
        const json = new TextDecoder().decode(data).replaceAll(`"${head.wall_ns}"`, `"${wall}"`);
        data = new TextEncoder().encode(json);
      }
      writer.attachment(name, kind, data, this.wall);
    }
    writer.flush();
  }

  record(node, k) {
    const { about, i } = node, works = this.exchange.nodes[i];
    const counted = {
      "supervisor.saturated": Number(works.clamped), "health.passes": k, "health.frames_sent": works.sent,
      "health.frames_received": works.received, "health.saturated_values": works.saturated,
      "timing.wall_s": k * this.head.period_ns * 1e-9,
    };
    for (const kind of ["state", "timing"]) {
      const into = node[kind];
      let at = into.add(k, this.stamp(k));
      into.view.setUint32(at, CDR_HEADER, true);
      at += 4;
      for (const name of about[kind]) {
        const value = counted[name] ?? this.values.at(i, name, k);
        if (value === value) into.view.setFloat64(at, value, true);
        else into.view.setBigUint64(at, NAN_WORD, true);
        at += 8;
      }
    }
    node.rows += 1;
  }

  open() {
    for (const node of this.nodes) for (const kind of ["state", "timing"]) {
      const about = node.about, id = this.ids.get(topicOf(about.name, kind));
      node[kind] = new Messages(id, 4 + 8 * about[kind].length, BATCH_CYCLES + 1);
    }
  }

  close(until) {
    for (const node of this.nodes) {
      this.writer.add(node.state, node.timing);
      this.frames(node);
      this.tell(node, until ?? node.rows);
    }
  }

  frames(node) {
    const id = this.ids.get(topicOf(node.about.name, "can/frames"));
    const into = new Messages(id, 28 + node.about.data_bytes, 16 * BATCH_CYCLES);
    for (const { cycle, frames } of node.pending) for (const { frame, data, received } of frames) {
      const at = into.add(cycle, this.stamp(cycle)), { view } = into;
      view.setUint32(at, CDR_HEADER, true);
      view.setBigUint64(at + 4, BigInt(cycle) * BigInt(this.head.period_ns), true);
      view.setBigUint64(at + 12, BigInt(cycle), true);
      view.setUint32(at + 20, frame.word, true);
      into.bytes.set([frame.dlc, received, 0, frame.flags], at + 24);
      into.bytes.set(data, at + 28);
    }
    node.pending = [];
    this.writer.add(into);
  }

  // Events and tunings of the cycles before `until`.
  tell(node, until) {
    while (node.entries.length && node.entries[0].cycle < until) this.entry(node, node.entries.shift());
  }

  entry(node, { topic, cycle, ...said }) {
    const id = this.ids.get(topicOf(node.about.name, topic)), stamp = cycle * this.head.period_ns;
    const text = JSON.stringify({ cycle, stamp_ns: stamp, ...said });
    this.writer.add(textMessage(id, cycle, this.stamp(cycle), text));
    node.events += 1;
  }

  bytes() {
    const { run, exchange, nodes } = this, below = (k) => {
      exchange.below(k);
      for (const node of nodes.slice(1)) this.record(node, k);
    };
    this.heads();
    this.open();
    exchange.meet();
    below(0);
    for (let k = 0; k < run.cycles; k++) {
      exchange.cycle(0, k);
      this.record(nodes[0], k);
      below(k + 1);
      if (nodes[0].state.count === BATCH_CYCLES) this.close(), this.open();
    }
    this.end();
    this.close(Infinity);
    this.counts();
    return this.writer.finish();
  }

  // The end of the rig's own run; a run that stopped earlier has none.
  end() {
    const { cycles } = this.run;
    if (cycles !== this.head.cycles || !this.exchange.end(cycles)) return;
    this.exchange.endBelow(cycles + 1);
    for (const node of this.nodes) {
      const state = node.about.at_end_event;
      node.entries.push({ topic: "events", cycle: cycles + (node.i > 0), ...state });
    }
  }

  counts() {
    const run = {}, frames = {}, away = {};
    for (const { about, rows, events, ...node } of this.nodes) {
      const { name } = about, written = { record: rows, frame: node.frames, event: events, alarm: 0, keyframe: 0 };
      for (const [kind, count] of Object.entries(written)) run[`written.${name}.${kind}`] = String(count);
      for (const kind of ["record", "frame", "event"]) run[`dropped.${name}.${kind}`] = "0";
      for (const [key, count] of [...node.counts].sort(([a], [b]) => a - b)) {
        const id = hex(key % 2 ** 40);
        frames[`${name}.${key >= 2 ** 40 ? `received.${id}.0` : `sent.${id}`}`] = String(count);
      }
      for (const [id, most] of node.away.entries(rows)) away[`${name}.${id}`] = most;
    }
    this.writer.flush();
    this.writer.metadata("run", { ...run, discarded: "0" });
    this.writer.metadata("frames", frames);
    this.writer.metadata("away", away);
  }
}

// A whole MCAP file of `run`: {cycles, column(name), tunings, settings}. Errors name the column that is missing.
export function logBytes(head, run, wallNs = BigInt(Date.now()) * 1000000n) {
  return new LogOfRun(head, run, wallNs).bytes();
}

// The columns of a log of this rig, {cycles, columns, tunings, settings, same}; an Error in one line otherwise.
// `same`: the log's rig is this one to the letter, so that a page can run it again.
export function readLog(head, bytes) {
  if (bytes.length > LOG_BYTES) throw new Error(`the log has ${Math.round(bytes.length / 1e6)} MB; a page reads 200`);
  let file;
  try {
    file = mcapContents(bytes);
  } catch (error) {
    throw new Error(`the log is damaged: ${error.message}; pcpc log recover keeps what is whole`);
  }
  const facts = file.metadata.get(head.nodes[0].name);
  if (!facts) throw new Error("an MCAP file, but not a log of pcpc");
  if (facts.rig !== head.rig) throw new Error(`a log of the rig ${facts.rig}; this page is of ${head.rig}`);
  if (facts.version_pcpc !== head.version) {
    throw new Error(`a log of pcpc ${facts.version_pcpc}; this page is of ${head.version}`);
  }
  if (facts.period_ns !== String(head.period_ns)) throw new Error("a log of another rate than this page's");
  const columns = {}, told = [];
  let cycles = Infinity;
  head.nodes.forEach((about, i) => {
    if (!file.metadata.has(about.name)) throw new Error(`a log without the node ${about.name}`);
    const variables = namesOf(file, topicOf(about.name, "state"));
    if (variables.length !== about.state.length || about.state.some((name) => !variables.includes(name))) {
      throw new Error(`a log of other variables of the ${about.name}; its rig has changed since`);
    }
    const rows = file.topics.get(topicOf(about.name, "state")) ?? [];
    cycles = Math.min(cycles, Math.max(rows.length - (i > 0), 0));
    about.state.forEach((name) => { columns[`${about.name}:${name}`] = new Float64Array(rows.length); });
    fillColumns(about, rows, columns);
    for (const body of file.topics.get(topicOf(about.name, "tunings")) ?? []) told.push(tuningOf(about, body));
  });
  if (!cycles) throw new Error("the log holds no cycle");
  const own = new Set(head.tunings.map((one) => JSON.stringify(one)));
  const given = told.filter((one) => !own.has(JSON.stringify(one)));
  const first = given.filter((one) => !one.cycle);
  const settings = Object.fromEntries(first.map((one) => [`${one.node}:${one.name}`, one.value]));
  const tunings = given.filter((one) => one.cycle).sort((a, b) => a.cycle - b.cycle);
  return { cycles, columns, tunings, settings, same: sameRig(head, file) };
}

// In the order of the messages: the schema's, which the metadata repeats.
function namesOf(file, topic) {
  try {
    return Object.values(file.metadata.get(`variables:${topic}`) ?? {}).map((text) => JSON.parse(text).name);
  } catch {
    throw new Error("the log's description of its variables is not readable");
  }
}

function fillColumns(about, rows, columns) {
  const places = about.state.map((name) => columns[`${about.name}:${name}`]);
  rows.forEach((body, k) => {
    const view = new DataView(body.buffer, body.byteOffset, body.length);
    if (body.length !== 26 + 8 * places.length || view.getUint32(2, true) !== k) {
      throw new Error(`the log does not hold every cycle of the ${about.name} from its start; cycle ${k} is missing`);
    }
    places.forEach((place, j) => { place[k] = view.getFloat64(26 + 8 * j, true); });
  });
}

function tuningOf(about, body) {
  try {
    const { cycle, name, value } = JSON.parse(new TextDecoder().decode(body.subarray(22)));
    if (Number.isInteger(cycle) && typeof name === "string" && Number.isFinite(value)) {
      return { cycle, node: about.name, name, value };
    }
  } catch {
    // as below
  }
  throw new Error(`a tuning of the ${about.name} in the log is not readable`);
}

function sameRig(head, file) {
  const ours = head.attachments.find(([name]) => name === "rig-resolved.yaml")?.[2];
  const theirs = file.attachments.get("rig-resolved.yaml");
  if (!ours || !theirs) return false;
  const own = attachedBytes(ours);
  return own.length === theirs.length && theirs.every((byte, i) => own[i] === byte);
}
