// MCAP records, written and read (mcap.dev/spec); all that is read has passed its checksum.
import { fzstd } from "./fzstd.js";
const MCAP_MAGIC = Uint8Array.of(0x89, 77, 67, 65, 80, 48, 13, 10);
const MCAP = {
  HEADER: 1, FOOTER: 2, SCHEMA: 3, CHANNEL: 4, MESSAGE: 5, CHUNK: 6, MESSAGE_INDEX: 7, CHUNK_INDEX: 8,
  ATTACHMENT: 9, ATTACHMENT_INDEX: 10, STATISTICS: 11, METADATA: 12, METADATA_INDEX: 13, DATA_END: 15,
};
const CHUNK_BYTES = 1 << 20, LARGEST_CHUNK = 16 << 20, MESSAGE_HEAD = 31;
const UNPACKED_PER_BYTE = 200;
const CRC_32 = Uint32Array.from({ length: 256 }, (_, byte) => {
  let crc = byte;
  for (let i = 0; i < 8; i++) crc = crc & 1 ? (crc >>> 1) ^ 0xedb88320 : crc >>> 1;
  return crc;
});

export function crc32(bytes, before = 0) {
  let crc = ~before;
  for (let i = 0; i < bytes.length; i++) crc = CRC_32[(crc ^ bytes[i]) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}

export function joined(parts) {
  const whole = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) whole.set(part, at), at += part.length;
  return whole;
}

const utf8 = (text) => new TextEncoder().encode(text);
function word(bytes, value) {
  const view = new DataView(new ArrayBuffer(8));
  view.setBigUint64(0, BigInt(value), true);
  return new Uint8Array(view.buffer, 0, bytes);
}
const u16 = (value) => word(2, value), u32 = (value) => word(4, value), u64 = (value) => word(8, value);
const sized = (bytes) => joined([u32(bytes.length), bytes]);
const str = (text) => sized(utf8(text));
const texts = (entries) => sized(joined(Object.entries(entries).flatMap(([key, text]) => [str(key), str(text)])));
const record = (opcode, ...parts) => {
  const body = joined(parts);
  return joined([Uint8Array.of(opcode), u64(body.length), body]);
};

// The CRC-32 that pcpc keeps in a metadata record: over JSON as Python writes it.
export function metadataCrc(name, entries) {
  const ascii = (text) => JSON.stringify(text).replace(/[\u0080-\uffff]/g,
    (letter) => `\\u${letter.charCodeAt(0).toString(16).padStart(4, "0")}`);
  const points = (text) => Array.from(text, (letter) => letter.codePointAt(0));
  const order = ([a], [b]) => {
    const x = points(a), y = points(b), i = x.findIndex((point, at) => point !== y[at]);
    return i < 0 ? x.length - y.length : x[i] - (y[i] ?? -1);
  };
  const pairs = Object.entries(entries).sort(order).map(([key, text]) => `[${ascii(key)}, ${ascii(text)}]`);
  return crc32(utf8(`[${ascii(name)}, [${pairs.join(", ")}]]`)).toString(16).padStart(8, "0");
}

// Messages of one channel, all of one size, one behind the other.
export class Messages {
  constructor(channel, payload, capacity = 64) {
    this.channel = channel; this.size = MESSAGE_HEAD + payload; this.count = 0;
    this.bytes = new Uint8Array(this.size * capacity);
    this.view = new DataView(this.bytes.buffer);
  }

  // The place of a new message's payload.
  add(cycle, logNs) {
    if ((this.count + 1) * this.size > this.bytes.length) {
      const more = new Uint8Array(2 * this.bytes.length);
      more.set(this.bytes);
      this.bytes = more; this.view = new DataView(more.buffer);
    }
    const at = this.count++ * this.size, view = this.view;
    view.setUint8(at, MCAP.MESSAGE);
    view.setBigUint64(at + 1, BigInt(this.size - 9), true);
    view.setUint16(at + 9, this.channel, true);
    view.setUint32(at + 11, cycle, true);
    view.setBigUint64(at + 15, logNs, true);
    view.setBigUint64(at + 23, logNs, true);
    return at + MESSAGE_HEAD;
  }
}

export function textMessage(channel, cycle, logNs, text) {
  const bytes = utf8(text), one = new Messages(channel, bytes.length, 1);
  one.bytes.set(bytes, one.add(cycle, logNs));
  return one;
}

// A file in the making.
export class McapWriter {
  constructor(head) {
    this.parts = [MCAP_MAGIC]; this.at = MCAP_MAGIC.length;
    this.indexes = []; this.counts = new Map(); this.chunks = 0; this.notes = 0; this.files = 0;
    this.first = null; this.last = 0n;
    this.described = joined([
      ...head.schemas.map(([id, name, kind, text]) => record(MCAP.SCHEMA, u16(id), str(name), str(kind), str(text))),
      ...head.channels.map(([id, schema, topic, kind]) =>
        record(MCAP.CHANNEL, u16(id), u16(schema), str(topic), str(kind), texts({}))),
    ]);
    this.kinds = [head.schemas.length, head.channels.length];
    this.put(record(MCAP.HEADER, str("ros2"), str("pcpc page")));
    this.begin([this.described]);
  }

  put(part) {
    this.parts.push(part);
    this.at += part.length;
    return this.at - part.length;
  }

  begin(pieces = []) {
    this.pieces = pieces; this.size = pieces.reduce((sum, piece) => sum + piece.length, 0);
    this.times = new Map(); this.span = null;
  }

  metadata(name, entries) {
    const whole = record(MCAP.METADATA, str(name), texts({ ...entries, crc32: metadataCrc(name, entries) }));
    this.indexes.push(record(MCAP.METADATA_INDEX, u64(this.put(whole)), u64(whole.length), str(name)));
    this.notes += 1;
  }

  attachment(name, kind, data, ns) {
    const body = joined([u64(ns), u64(ns), str(name), str(kind), u64(data.length), data]);
    const whole = record(MCAP.ATTACHMENT, body, u32(crc32(body)));
    this.indexes.push(record(MCAP.ATTACHMENT_INDEX, u64(this.put(whole)), u64(whole.length), u64(ns), u64(ns),
      u64(data.length), str(name), str(kind)));
    this.files += 1;
  }

  // What belongs together comes into one chunk.
  add(...all) {
    if (this.size + all.reduce((sum, one) => sum + one.count * one.size, 0) > CHUNK_BYTES) this.flush();
    for (const one of all) if (one.count) this.take(one);
  }

  take(messages) {
    const { channel, count, size } = messages;
    const times = this.times.get(channel) ?? [];
    this.times.set(channel, times);
    for (let i = 0; i < count; i++) {
      const ns = messages.view.getBigUint64(i * size + 15, true);
      times.push([ns, this.size + i * size]);
      this.span ??= [ns, ns];
      if (ns < this.span[0]) this.span[0] = ns;
      if (ns > this.span[1]) this.span[1] = ns;
    }
    this.pieces.push(messages.bytes.subarray(0, count * size));
    this.size += count * size;
    this.counts.set(channel, (this.counts.get(channel) ?? 0) + count);
  }

  flush() {
    if (!this.size) return;
    const data = joined(this.pieces), [low, high] = this.span ?? [0n, 0n], size = u64(data.length);
    const whole = record(MCAP.CHUNK, u64(low), u64(high), size, u32(crc32(data)), str(""), size, data);
    const at = this.put(whole), offsets = [];
    let bytes = 0;
    for (const [channel, times] of this.times) {
      const body = new Uint8Array(16 * times.length), view = new DataView(body.buffer);
      times.forEach(([ns, place], i) => {
        view.setBigUint64(16 * i, ns, true);
        view.setBigUint64(16 * i + 8, BigInt(place), true);
      });
      const index = record(MCAP.MESSAGE_INDEX, u16(channel), sized(body));
      offsets.push(u16(channel), u64(this.put(index)));
      bytes += index.length;
    }
    this.indexes.push(record(MCAP.CHUNK_INDEX, u64(low), u64(high), u64(at), u64(whole.length),
      sized(joined(offsets)), u64(bytes), str(""), size, size));
    this.chunks += 1;
    if (this.span) {
      if (this.first === null || low < this.first) this.first = low;
      if (high > this.last) this.last = high;
    }
    this.begin();
  }

  finish() {
    let crc = 0, total = 0;
    for (const part of this.parts) crc = crc32(part, crc);
    this.put(record(MCAP.DATA_END, u32(crc)));
    for (const count of this.counts.values()) total += count;
    const counts = joined([...this.counts].flatMap(([channel, count]) => [u16(channel), u64(count)]));
    const statistics = record(MCAP.STATISTICS, u64(total), u16(this.kinds[0]), u32(this.kinds[1]), u32(this.files),
      u32(this.notes), u32(this.chunks), u64(this.first ?? 0), u64(this.last), sized(counts));
    const summary = joined([this.described, statistics, ...this.indexes]);
    const footer = joined([Uint8Array.of(MCAP.FOOTER), u64(20), u64(this.at), u64(0)]);
    this.put(summary);
    return joined([...this.parts, footer, u32(crc32(footer, crc32(summary))), MCAP_MAGIC]);
  }
}

// A cursor over bytes; an Error where they are cut.
class Cursor {
  constructor(bytes) {
    this.bytes = bytes; this.at = 0;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  }

  take(count) {
    if (!(count <= this.bytes.length - this.at)) throw new Error("a record is cut");
    this.at += count;
    return this.bytes.subarray(this.at - count, this.at);
  }

  number(bytes) {
    this.take(bytes);
    const at = this.at - bytes, view = this.view;
    if (bytes === 1) return view.getUint8(at);
    if (bytes === 2) return view.getUint16(at, true);
    return bytes === 4 ? view.getUint32(at, true) : Number(view.getBigUint64(at, true));
  }

  text() {
    return new TextDecoder().decode(this.take(this.number(4)));
  }

  texts() {
    const inside = new Cursor(this.take(this.number(4))), found = {};
    while (inside.at < inside.bytes.length) Object.defineProperty(found, inside.text(),
      { value: inside.text(), enumerable: true, configurable: true, writable: true });
    return found;
  }
}

function unpacked(body, budget) {
  const chunk = new Cursor(body);
  chunk.take(16);
  const size = chunk.number(8), crc = chunk.number(4), how = chunk.text();
  const packed = chunk.take(chunk.number(8));
  if (size > LARGEST_CHUNK) throw new Error("a chunk is larger than those of any log");
  if ((budget.left -= size) < 0) throw new Error("it unpacks to more than any log");
  if (how !== "" && how !== "zstd") throw new Error(`its compression ${how.slice(0, 20)} is not known here`);
  const data = how ? fzstd.decompress(packed, new Uint8Array(size)) : packed;
  if (data.length !== size || crc32(data) !== crc) throw new Error("a chunk's checksum does not match");
  return data;
}

// Topics with the bytes of their messages in order, metadata and attachments of a whole file.
export function mcapContents(bytes) {
  if (bytes.length < 45 || MCAP_MAGIC.some((byte, i) => bytes[i] !== byte)) throw new Error("no MCAP file");
  if (MCAP_MAGIC.some((byte, i) => bytes[bytes.length - 8 + i] !== byte)) throw new Error("its end is missing");
  const file = new Cursor(bytes), topics = new Map(), metadata = new Map(), attachments = new Map();
  const channels = new Map(), budget = { left: LARGEST_CHUNK + UNPACKED_PER_BYTE * bytes.length };
  file.take(8);
  for (;;) {
    const begin = file.at, opcode = file.number(1), body = file.take(file.number(8)), part = new Cursor(body);
    if (opcode === MCAP.DATA_END) {
      const crc = part.number(4);
      if (crc && crc !== crc32(bytes.subarray(0, begin))) throw new Error("the checksum of all data does not match");
      const end = bytes.length - 12;
      if (crc32(bytes.subarray(file.at, end)) !== file.view.getUint32(end, true)) {
        throw new Error("the summary's checksum does not match");
      }
      return { topics, metadata, attachments };
    }
    if (opcode === MCAP.METADATA) {
      const name = part.text(), entries = part.texts(), crc = entries.crc32;
      delete entries.crc32;
      if (crc !== metadataCrc(name, entries)) throw new Error("a metadata record's checksum does not match");
      metadata.set(name, entries);
    } else if (opcode === MCAP.ATTACHMENT) {
      part.take(16);
      const name = part.text();
      part.text();
      const data = part.take(part.number(8)), end = part.at;
      if (part.number(4) !== crc32(body.subarray(0, end))) throw new Error("an attachment's checksum does not match");
      attachments.set(name, data);
    } else if (opcode === MCAP.CHUNK) {
      takeChunk(unpacked(body, budget), channels, topics);
    } else if (opcode !== MCAP.HEADER && opcode !== MCAP.MESSAGE_INDEX) {
      throw new Error(`a record of kind ${opcode} does not belong there`);
    }
  }
}

function takeChunk(data, channels, topics) {
  const chunk = new Cursor(data);
  while (chunk.at < data.length) {
    const opcode = chunk.number(1), size = chunk.number(8), body = chunk.take(size);
    if (opcode === MCAP.CHANNEL) {
      const channel = new Cursor(body), id = channel.number(2);
      channel.take(2);
      const topic = channel.text();
      if (!topics.has(topic)) topics.set(topic, []);
      channels.set(id, topics.get(topic));
    } else if (opcode === MCAP.MESSAGE) {
      if (size < MESSAGE_HEAD - 9) throw new Error("a message is cut");
      channels.get(body[0] | (body[1] << 8))?.push(body);
    }
  }
}
