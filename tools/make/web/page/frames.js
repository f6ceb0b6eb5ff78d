// The frames of a run in their order, with their bytes: executive/loop/exchange.py, drivers/can/codec.py, e2e.py.
const TWO_52 = 2 ** 52, HALVES = new DataView(new ArrayBuffer(8));
const real = (value) => (value === "inf" ? Infinity : value === "-inf" ? -Infinity : value);

function crcTable(polynomial, bits) {
  return Array.from({ length: 256 }, (_, byte) => {
    let crc = byte << (bits - 8);
    for (let i = 0; i < 8; i++) crc = (crc << 1) ^ ((crc >> (bits - 1)) & 1 ? polynomial : 0);
    return crc & ((1 << bits) - 1);
  });
}
const CRC_8 = crcTable(0x1d, 8), CRC_16 = crcTable(0x1021, 16);

function halfEven(x) {
  let size = Math.abs(x);
  if (size < TWO_52) size = size + TWO_52 - TWO_52;
  return x < 0 ? -size : size;
}

// The raw word of a value, and whether it lies outside of what the signal holds.
function rawWord(signal, value) {
  const low = real(signal.code_low), high = real(signal.code_high);
  let code = (value - signal.offset) / signal.factor, bits = 0n;
  if (signal.kind.startsWith("FLOAT")) {
    const near = Math.min(Math.max(code, low), high);
    if (signal.kind === "FLOAT_32") HALVES.setFloat32(0, near), bits = BigInt(HALVES.getUint32(0));
    else HALVES.setFloat64(0, near), bits = HALVES.getBigUint64(0);
    if (code !== code) bits = 0n;
  } else {
    code = halfEven(code);
    if (code < low) bits = BigInt(signal.bits[0]);
    else if (code > high) bits = BigInt(signal.bits[1]);
    else if (code === code) bits = BigInt(code);
  }
  return [BigInt.asUintN(64, bits) & BigInt(signal.mask), !(code >= low && code <= high)];
}

// Write a frame's signals and protection into `data`; return how many were clamped.
export function packFrame(frame, values, counter, data) {
  data.fill(0);
  const view = new DataView(data.buffer, data.byteOffset), chosen = frame.signals[frame.selector - 1];
  const layout = chosen ? Number(rawWord(chosen, values(chosen.name))[0]) : -1;
  let clamped = 0;
  for (const signal of frame.signals) {
    if (chosen && signal.layout && signal.layout !== layout + 1) continue;
    const [bits, outside] = rawWord(signal, values(signal.name)), little = !signal.big_endian;
    const word = view.getBigUint64(signal.byte, little) | BigInt.asUintN(64, bits << BigInt(signal.shift));
    view.setBigUint64(signal.byte, word, little);
    clamped += outside;
  }
  protect(frame, counter, data);
  return clamped;
}

function protect(frame, counter, data) {
  if (!frame.protected) return;
  const mask = frame.counter_mask, shift = frame.counter_shift, at = frame.crc_byte;
  data[frame.counter_byte] = (data[frame.counter_byte] & ~(mask << shift)) | ((counter & mask) << shift);
  if (frame.protected === 1) {
    let crc = CRC_8[CRC_8[0xff ^ (frame.can_id & 0xff)] ^ ((frame.can_id >> 8) & 0xff)];
    for (let i = 0; i < at; i++) crc = CRC_8[crc ^ data[i]];
    data[at] = crc ^ 0xff;
    return;
  }
  let crc = 0xffff;
  const id = [frame.data_id & 0xff, frame.data_id >> 8];
  for (const byte of [...data.subarray(0, at), ...data.subarray(at + 2, frame.dlc), ...id]) {
    crc = ((crc << 8) & 0xffff) ^ CRC_16[(crc >> 8) ^ byte];
  }
  data[at] = crc & 0xff;
  data[at + 1] = crc >> 8;
}

// The nodes of a rig, which send what their columns say; `note(node, cycle, frame, received)` takes each frame.
// `value(node, name, cycle)`: of a recorded variable.
export class Exchange {
  constructor(head, value, note) {
    this.head = head; this.value = value; this.note = note;
    this.nodes = head.nodes.map((about) => ({
      about, heard: new Set(about.heard), inbox: [], sent: 0, received: 0, saturated: 0, clamped: false,
    }));
    this.above = this.nodes.length - head.peers;
  }

  neighbours(i) {
    if (this.head.peers > 1) return i === 0 ? this.nodes.slice(1) : [this.nodes[0]];
    return [this.nodes[i - 1], this.nodes[i + 1]].filter(Boolean);
  }

  send(i, frame, counter, cycle, values) {
    const node = this.nodes[i], data = new Uint8Array(Math.max(8, frame.dlc));
    const clamped = packFrame(frame, values, counter, data), sent = { frame, data };
    node.saturated += clamped;
    node.clamped ||= clamped > 0;
    node.sent += 1;
    this.note(i, cycle, sent, 0);
    for (const other of this.neighbours(i)) if (other.heard.has(frame.word)) other.inbox.push(sent);
  }

  hear(i, cycle) {
    const node = this.nodes[i];
    for (const one of node.inbox.splice(0)) {
      node.received += 1;
      this.note(i, cycle, one, 1);
    }
  }

  beat(i, cycle, values) {
    for (const frame of this.nodes[i].about.sent) if (frame.beat) this.send(i, frame, 0, cycle, values);
  }

  transmit(i, cycle, values) {
    for (const frame of this.nodes[i].about.sent) {
      const every = frame.every_n;
      if (cycle % every === 0) this.send(i, frame, Math.floor(cycle / every) + frame.sync, cycle, values);
    }
  }

  meet() {
    const first = (i) => (name) => (this.nodes[i].about.steps[name] ?? [[0, 0]])[0][1];
    for (let i = this.above; i < this.nodes.length; i++) this.beat(i, 0, first(i));
    for (let i = this.above - 1; i >= 0; i--) {
      this.hear(i, 0);
      this.beat(i, 0, first(i));
      for (const frame of this.nodes[i].about.sent) if (frame.sync) this.send(i, frame, 0, 0, first(i));
    }
  }

  cycle(i, k) {
    const node = this.nodes[i];
    node.clamped = false;
    this.hear(i, k);
    for (const [name, limit] of Object.entries(node.about.limits)) {
      const wanted = this.value(i, limit.source, k);
      if (wanted !== undefined && wanted !== this.value(i, name, k)) node.saturated += 1, node.clamped = true;
    }
    this.transmit(i, k, (name) => this.value(i, name, k));
  }

  below(k) {
    for (let i = this.nodes.length - 1; i > 0; i--) this.cycle(i, k);
  }

  // The last word after cycle k - 1; false, and nothing is sent, if a command has a way to go to be safe.
  end(k) {
    const about = this.nodes[0].about, last = new Map(Object.entries(about.at_end));
    for (const [name, limit] of Object.entries(about.limits)) {
      const sent = this.value(0, name, k - 1), rate = real(limit.rate), safe = limit.safe;
      if (Math.abs(sent - safe) > rate) return false;
      last.set(name, safe === 0 ? 0 * sent : safe);
    }
    this.transmit(0, k, (name) => last.get(name) ?? this.value(0, name, k - 1));
    return true;
  }

  endBelow(k) {
    for (let i = this.nodes.length - 1; i > 0; i--) {
      this.hear(i, k);
      const ends = this.nodes[i].about.at_end;
      this.beat(i, k, (name) => ends[name] ?? this.value(i, name, k - 1));
    }
  }
}
