// The connection: a token first, then messages both ways; it comes back by itself.

import { chosen } from "./runs.js";

const STATES = { open: ["connected", "good"], lost: ["reconnecting", "warn"], closed: ["closed", "bad"] };
const WRONG_TOKEN = 4401, TOO_MANY = 4429, BAD_MESSAGE = 4400;
const RATE = 40, BURST = 100; // messages a second, at once: fewer than the server's guard allows
const FIRST_ASKED = 500000, LAST_ASKED = 1000000; // ids of what is answered; panels have smaller ones

export class Net {
  constructor(heard, drawn, changed) {
    this.heard = heard; this.drawn = drawn; this.changed = changed;
    this.socket = null; this.wait_ms = 250; this.next = FIRST_ASKED; this.waiting = new Map();
    this.wishes = new Map(); this.left = BURST; this.seen_ms = performance.now(); this.timer = null;
    this.connect();
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      socket.send(JSON.stringify({ do: "hello", token: location.hash.slice(1), run: chosen() }));
    };
    socket.onmessage = (event) => {
      if (this.wait_ms !== 250 || !this.open) {
        this.open = true; this.wait_ms = 250; this.changed(...STATES.open);
      }
      if (event.data instanceof ArrayBuffer) { this.drawn(event.data); return; }
      const message = JSON.parse(event.data);
      const id = message.done ?? message.refused;
      if (id !== undefined && this.waiting.has(id)) {
        this.waiting.get(id)(message); this.waiting.delete(id);
      }
      this.heard(message);
    };
    socket.onclose = (event) => {
      this.open = false;
      for (const answer of this.waiting.values()) answer({ why: "the connection was lost; ask again" });
      this.waiting.clear(); this.wishes.clear();
      if (event.code === WRONG_TOKEN) {
        this.changed("wrong token: open the address that `pcpc host` printed", "bad");
        return;
      }
      const why = [TOO_MANY, BAD_MESSAGE].includes(event.code) ? `${event.reason}; reconnecting` : STATES.lost[0];
      this.changed(why, STATES.lost[1]);
      setTimeout(() => this.connect(), this.wait_ms);
      this.wait_ms = Math.min(2 * this.wait_ms, 4000);
    };
  }

  // What is shown, as often as the server takes it: of wishes about one panel only the newest waits.
  say(message) {
    if (!this.open) return;
    this.wishes.set(message.id ?? message.do, message); this.flush();
  }

  flush() {
    const now_ms = performance.now();
    this.left = Math.min(BURST, this.left + 0.001 * RATE * (now_ms - this.seen_ms)); this.seen_ms = now_ms;
    for (const [key, message] of this.wishes) {
      if (this.left < 1) { this.timer ??= setTimeout(() => { this.timer = null; this.flush(); }, 1000 / RATE); return; }
      this.wishes.delete(key); this.send(message);
    }
  }

  send(message) { this.left--; this.socket.send(JSON.stringify(message)); }

  // Ask for something that is answered; a promise of the answer.
  ask(message) {
    if (!this.open) return Promise.resolve({ why: "not connected" });
    const id = this.next = this.next < LAST_ASKED ? this.next + 1 : FIRST_ASKED;
    return new Promise((answer) => { this.waiting.set(id, answer); this.send({ ...message, id }); });
  }
}
