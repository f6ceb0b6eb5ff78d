// What stands beside the curves: variables, parameters, the run's state, timing, frames, events.

import { paint } from "./drawing.js";
import { Operate } from "./operate.js";
import { css, el } from "./panels.js";

const by = (id) => document.getElementById(id);
const STATES = { RUN: "good", READY: "good", HOLD: "warn", FAULT: "bad", ended: "quiet" };
const ACTIONS = { stop: "stop", quick_stop: "quick stop", reset: "reset fault", forget_timing: "clear timing", clear: "clear curves",
  lock: "lock tuning", unlock: "allow tuning" };
const STILL = matchMedia("(prefers-reduced-motion: reduce)"); // then the plant moves once a second
const MOST_EVENTS = 200, MOST_ROWS = 200;

export class Side {
  constructor(page) {
    this.page = page; this.inputs = new Map(); this.late = null;
    this.recording = this.savedBadly = false; this.saved = ""; this.lastRecording = null;
    by("search").oninput = () => this.list();
    by("search").onkeydown = (event) => {
      if (event.key === "ArrowDown") { event.preventDefault(); by("variables").firstChild?.focus(); }
      if (event.key !== "Enter") return;
      const first = by("variables").firstChild, said = by("search").value.trim();
      if (said.startsWith("=")) this.page.pick(said);
      else if (first?.dataset.name) this.page.pick(first.dataset.name);
    };
    by("search-parameters").oninput = () => this.tunables();
    by("undo").onclick = () => this.act({ do: "undo" }, "undone");
    for (const [what, text] of Object.entries(ACTIONS)) {
      const button = el("button", "", text);
      button.onclick = () => this.act({ do: "act", what }, text).then(() => what === "clear" && this.page.again());
      button.dataset.what = what;
      by("actions").append(button, " ");
    }
    this.operate = new Operate(by("operate"), (message, what) => this.act(message, what));
    by("record").onclick = () => this.record({ do: "record", end: this.recording });
    by("snapshot").onclick = () => this.record({ do: "snapshot" });
    by("slider").oninput = () => this.moved();
    by("play").onclick = () => { this.playing = this.playing ? null : performance.now(); };
  }

  shown(about, span) {
    this.about = about; this.values = new Map(); this.inputs.clear();
    by("events").replaceChildren(); this.saved = "";
    this.scene = null; this.painted_ms = NaN; by("drawing-box").hidden = true;
    for (const id of ["tuning-box", "control-box", "recording-box", "timing-box", "frames-box", "events-box"]) by(id).hidden = !about.live;
    by("slider-box").hidden = !span;
    this.playing = span && about.note ? performance.now() : null;
    if (span) { [by("slider").min, by("slider").max] = span; by("slider").value = span[0]; this.moved(); }
    else this.page.instant = null;
    if (!about.live) by("nodes").replaceChildren(el("span", "pill quiet", "finished log"));
    by("faults").replaceChildren(...[...new Set(about.faults.map((one) => one.name))].map((name) => {
      const button = el("button", "", `fault ${name}, 1 s`);
      button.title = about.faults.find((one) => one.name === name).about;
      button.onclick = () => this.act({ do: "fault", name, for_s: 1 }, name);
      return button;
    }));
    for (const button of document.querySelectorAll("#actions button, #faults button, #recording-box button")) button.disabled = !about.write && button.dataset.what !== "clear";
    by("undo").disabled = true;
    this.operate.shown(about);
    this.list(); this.tunables();
    this.answer(about.live && !about.write ? "view only; `pcpc host --write` lets this page tune" : "", "quiet");
  }

  list() {
    if (by("search").value.trim().startsWith("=")) {
      by("variables").replaceChildren(el("li", "quiet", "Enter draws it, as = abs(controller.e_rad) * 1000"));
      return;
    }
    const words = by("search").value.toLowerCase().split(/\s+/);
    const found = [...this.page.variables.values()].filter((one) => one.plot
      && words.every((word) => `${one.name} ${one.help}`.toLowerCase().includes(word)));
    by("variables").replaceChildren(...found.slice(0, MOST_ROWS).map((one, i) => {
      const item = el("li", "", `${one.name}${one.unit ? ` [${one.unit}]` : ""}`);
      item.title = one.help; item.dataset.name = one.name; item.draggable = true;
      item.tabIndex = i ? -1 : 0; item.setAttribute("role", "option"); // Tab finds the list, arrows its rows
      item.onclick = () => this.page.pick(one.name);
      item.onkeydown = (event) => this.key(event, item);
      item.ondragstart = (event) => event.dataTransfer.setData("text/plain", one.name);
      return item;
    }));
    if (found.length > MOST_ROWS) by("variables").append(el("li", "quiet", `and ${found.length - MOST_ROWS} more`));
  }

  key(event, item) {
    const beside = { ArrowDown: item.nextElementSibling, ArrowUp: item.previousElementSibling ?? by("search") }[event.key];
    if (event.key === "Enter" || event.key === " ") this.page.pick(item.dataset.name);
    else if (beside) beside.focus();
    else return;
    event.preventDefault();
  }

  tunables() {
    const word = by("search-parameters").value.toLowerCase();
    const own = (one) => !/^(plant:|local:)?(supervisor|timing|fault)\./.test(one.name);
    const found = [...this.page.variables.values()].filter((one) => one.range && own(one)
      && (one.range[0] !== null || one.range[1] !== null || word) && one.name.toLowerCase().includes(word));
    this.inputs.clear();
    by("parameters").replaceChildren(...found.slice(0, MOST_ROWS).map((one) => this.row(one)));
  }

  row(one) {
    const label = el("label"), input = el("input");
    input.type = "text"; input.inputMode = "decimal"; input.disabled = !this.about.write;
    input.value = text(this.values.get(one.name));
    label.title = `${one.help}; ${text(one.range[0])} .. ${text(one.range[1])} ${one.unit}`;
    const name = el("span"); // breaks behind _ . : rather than anywhere
    name.append(...one.name.split(/(?<=[_.:])/).flatMap((word) => [el("wbr"), word]));
    label.append(name, input, el("span", "quiet", one.unit));
    input.oninput = () => input.classList.add("changed");
    input.onkeydown = (event) => {
      if (event.key === "Enter") this.set(one, input);
      if (event.key === "Escape") this.show(one.name, input);
    };
    this.inputs.set(one.name, input);
    return label;
  }

  set(one, input) {
    const value = Number(input.value.trim().replace(",", "."));
    if (!input.value.trim() || !Number.isFinite(value)) {
      this.answer(`${one.name}: ${input.value || "nothing"} is no number; `
        + `${text(one.range[0])} .. ${text(one.range[1])} ${one.unit}`, "bad");
      return;
    }
    input.classList.remove("changed");
    this.act({ do: "set", values: { [one.name]: value } }, `${one.name} = ${value}`).then((answer) => {
      if (answer.why && !input.classList.contains("changed")) this.show(one.name, input); // not typed on since
    });
  }

  show(name, input) { input.classList.remove("changed"); input.value = text(this.values.get(name)); }

  async act(message, what) {
    const answer = await this.page.net.ask(message);
    if (answer.why) this.answer(answer.why, "bad");
    else this.answer(`${what}: from cycle ${answer.cycle}`, "good");
    if (message.do !== "set") { // what was typed since a value was sent stays; a status may have come before this
      for (const name of Object.keys(answer.values ?? {})) if (this.inputs.has(name)) this.show(name, this.inputs.get(name));
    }
    if (answer.undoes !== undefined) by("undo").disabled = !answer.undoes;
    return answer;
  }

  answer(what, kind) { by("answer").textContent = what; by("answer").className = kind; }

  heard(message) {
    if (message.event) this.happened(message.event);
    if (message.scene) { this.scene = message.scene; this.painted = false; }
    if (message.status) this.status(message.status);
  }

  // Begin or end a recording, or write what was; the file's name comes from the host.
  async record(message) {
    const answer = await this.page.net.ask(message);
    this.saved = answer.why ? answer.why : answer.first !== undefined
      ? `${answer.file}: cycles ${answer.first} to ${answer.last}` : "";
    this.savedBadly = Boolean(answer.why);
    this.recorded(this.lastRecording);
  }

  recorded(one) {
    this.lastRecording = one; this.recording = Boolean(one?.going);
    by("record").textContent = this.recording ? "stop recording" : "record";
    by("record").classList.toggle("on", this.recording);
    const lost = one?.lost ? `, ${one.lost} rows lost` : "", lines = [];
    if (one) lines.push([`${one.file}: ${one.going ? "recording, " : ""}${one.cycles} cycles, ${one.mb.toFixed(1)} MB${lost}${one.why ? `; ended: ${one.why}` : ""}`, one.why || one.lost ? "warn" : ""]);
    if (this.saved) lines.push([this.saved, this.savedBadly ? "bad" : "good"]);
    by("recorded").replaceChildren(...lines.map(([what, kind]) => el("div", kind, what)));
    const words = this.recording ? `recording ${one.file}` : by("recorded").textContent;
    if (by("said").textContent !== words) by("said").textContent = words; // not every size is read out
  }

  // Bits at most on the bus, over its rate, and which node sent how many.
  load({ bitrate, bits_per_s, sent }) {
    if (bits_per_s === undefined) { by("bus-load").textContent = ""; return; }
    const kbit = (bits) => `${(1e-3 * bits).toFixed(0)} kbit/s`;
    const share = bitrate ? `, ${(100 * bits_per_s / bitrate).toFixed(0)} % of ${kbit(bitrate)}` : "";
    const from = Object.entries(sent).map(([role, bits]) => `${role} ${kbit(bits)}`).join(", ");
    by("bus-load").textContent = `load ${kbit(bits_per_s)} at most${share}; from ${from}`;
  }

  status({ nodes, values, load, recording }) {
    this.operate.status(nodes);
    this.load(load); this.recorded(recording);
    for (const [name, value] of Object.entries(values)) {
      this.values.set(name, value);
      const input = this.inputs.get(name);
      if (input && !input.classList.contains("changed")) input.value = text(value);
    }
    by("nodes").replaceChildren(...Object.entries(nodes).map(([role, one]) => {
      const pill = el("span", `pill ${STATES[one.state] ?? "warn"}`,
        `${role} ${one.state} ${one.t_s.toFixed(1)} s ${one.rate_hz.toFixed(0)} Hz${one.fault ? `: ${one.fault}` : ""}`);
      return pill;
    }));
    const roles = Object.keys(nodes), rows = [["", ...roles]];
    const first = nodes[roles[0]];
    for (const name of Object.keys(first.times)) {
      rows.push([name.replaceAll("_", " ").replace(" us", ", us"), ...roles.map((role) => text(nodes[role].times[name]))]);
    }
    for (const name of Object.keys(first.counters)) {
      if (roles.some((role) => nodes[role].counters[name])) rows.push([name, ...roles.map((role) => nodes[role].counters[name])]);
    }
    by("timing").replaceChildren(...rows.map((row, i) => line(row, i ? "td" : "th")));
    this.late = first.late;
    const frames = [["frame", "id", "every, ms", "jitter", "signals"]];
    for (const one of first.frames) {
      const told = Object.entries(one.signals).map(([name, value]) => `${name} ${value === null ? "–" : +value.toPrecision(5)}`);
      const times = [one.period_ms, one.jitter_ms].map((ms) => ms === undefined ? "" : ms.toFixed(3));
      frames.push([`${one.way} ${one.name}`, `0x${one.id.toString(16)}`, ...times, told.join(", ")]);
    }
    by("frames").replaceChildren(...frames.map((row, i) => line(row, i ? "td" : "th")));
  }

  happened(event) {
    const t = (event.cycle * this.about.period_s).toFixed(3);
    const what = event.topic === "tunings" ? `${event.name} = ${event.value}`
      : `${event.event}${event.name ? ` ${event.name}` : ""}${event.value ? ` ${event.value}` : ""}`;
    by("events").prepend(el("li", event.event === "fault" ? "bad" : "", `${t} s  cycle ${event.cycle}  ${event.node}: ${what}`));
    while (by("events").children.length > MOST_EVENTS) by("events").lastChild.remove();
  }

  moved() {
    const t = +by("slider").value;
    by("slider-time").textContent = `${t.toFixed(3)} s`;
    this.page.at(t);
  }

  frame() {
    if (this.playing) {
      const now = performance.now(), slider = by("slider");
      if (this.about.note && +slider.value >= +slider.max) slider.value = slider.min; // round and round
      slider.value = Math.min(+slider.max, +slider.value + 1e-3 * (now - this.playing));
      this.playing = +slider.value < +slider.max || this.about.note ? now : null;
      this.moved();
    }
    const now = performance.now(), often = STILL.matches ? 1000 : 0;
    if (this.scene && !this.painted && !(now - this.painted_ms < often)) {
      by("drawing-box").hidden = false; this.painted = true; this.painted_ms = now;
      paint(by("drawing"), this.scene);
    }
    by("play").textContent = this.playing ? "stop" : "play";
    if (this.late && !by("timing-box").hidden) { this.histogram(this.late); this.late = null; }
  }

  // How many cycles woke how late, an octave a bar, counts on a logarithmic scale.
  histogram(octaves) {
    const canvas = by("histogram"), g = canvas.getContext("2d"), { width, height } = canvas;
    g.clearRect(0, 0, width, height);
    const most = Math.log10(1 + Math.max(1, ...octaves.map((one) => one[1]))), each = width / Math.max(octaves.length, 8);
    g.font = "16px system-ui"; g.textAlign = "center";
    const short = (n) => n < 1000 ? `${+n.toPrecision(2)}` : n < 1e6 ? `${Math.round(n / 1e3)}k` : `${Math.round(n / 1e6)}M`;
    octaves.forEach(([end, count], i) => {
      const high = (height - 44) * Math.log10(1 + count) / most;
      g.fillStyle = css("--accent"); g.fillRect(i * each + 2, height - 22 - high, each - 4, high);
      g.fillStyle = css("--text");
      g.fillText(short(end), (i + 0.5) * each, height - 4);
      if (count) g.fillText(count < 1000 ? count : short(count), (i + 0.5) * each, height - 26 - high);
    });
  }
}

function text(value) { return value === null || value === undefined ? "" : String(+value.toPrecision(9)); }

function line(cells, tag) {
  const row = el("tr");
  cells.forEach((cell, i) => row.append(el(tag, tag === "td" && i && typeof cell === "number" || /^-?[\d.]+$/.test(cell) ? "number" : "", cell)));
  return row;
}
