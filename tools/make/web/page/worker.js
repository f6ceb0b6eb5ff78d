// Runs a rig: as many cycles as the clock asks for, a batch at a time.
const SLICE_MS = 8, BUSY_MS = 14, MOST = 256;
let id = 0, wasm, columns, cycles, periodS, now = 0, speed = 0, begun = 0, from = 0, timer = 0;

// Where a value lies that can be set.
const view = (node, i) => new Float64Array(wasm.memory.buffer, wasm.place(node, i), 1);

function rows() {
  return columns.map((n, i) => new Float64Array(wasm.memory.buffer, wasm.rows(i), n * wasm.count(i)).slice());
}

// Each message tells of which run it is: a page that has begun another leaves it.
const tell = (message, buffers) => postMessage({ id, now, ...message }, buffers);
const send = (kind, parts) => tell({ kind, parts }, parts.map((part) => part.buffer));

function advance(n) {
  const next = wasm.run(Math.min(n, MOST));
  const done = next - now;
  now = next;
  if (done) send("rows", rows());
  return done;
}

function slice() {
  timer = 0;
  if (!speed) return;
  const end = performance.now() + BUSY_MS;
  const target = speed === Infinity ? cycles : from + Math.floor((performance.now() - begun) * 1e-3 * speed / periodS);
  while (now < Math.min(target, cycles) && performance.now() < end) advance(Math.min(target, cycles) - now);
  if (now >= cycles) { speed = 0; tell({ kind: "ended" }); }
  if (speed) timer = setTimeout(() => guarded(slice), speed === Infinity ? 0 : SLICE_MS);
}

function go(to) {
  speed = to; begun = performance.now(); from = now;
  if (speed && !timer) timer = setTimeout(() => guarded(slice), 0);
}

async function start(data) {
  go(0);
  ({ id, columns, cycles, periodS } = data);
  const made = await WebAssembly.instantiate(data.module);
  wasm = made.instance.exports;
  const refused = wasm.start();
  if (refused) throw new Error(`this browser does not give the bits of every other machine (self-test ${refused})`);
  for (const [node, i, value] of data.values) view(node, i)[0] = value;
  now = wasm.run(0);
  send("rows", rows());
  tell({ kind: "ready" });
}

function step(n) {
  go(0);
  for (let done = 1; n > 0 && done > 0; n -= done) done = advance(n);
  if (now >= cycles) tell({ kind: "ended" });
}

// From the next cycle on; a value that is `later` is a time after the begin of that cycle. Nodes
// below the first are a cycle ahead.
function set({ values, tuning }) {
  const given = values.map(([node, , value, later]) => (later ? +(value + (now + (node > 0)) * periodS).toPrecision(12) : value));
  values.forEach(([node, i], k) => { view(node, i)[0] = given[k]; });
  tell({ kind: "tuned", tuning, given });
}

const guarded = (work) => Promise.resolve().then(work).catch((error) => {
  speed = 0;
  tell({ kind: "failed", why: String(error.message ?? error) });
});

function handled(data) {
  if (data.kind === "start") return start(data);
  if (data.kind === "go") go(data.speed);
  if (data.kind === "step") step(data.cycles);
  if (data.kind === "set") set(data);
  return undefined;
}

let before = Promise.resolve(); // a module is there before what follows is done with it
onmessage = ({ data }) => (before = before.then(() => guarded(() => handled(data))));
