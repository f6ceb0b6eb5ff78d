// node rig_log.mjs write|read HEAD RUN|LOG OUT: what a page does, for test_page_log.py.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [page, what, headFile, input, out] = process.argv.slice(2);
const { logBytes, readLog } = await import(pathToFileURL(`${page}/log.js`));
const head = JSON.parse(readFileSync(headFile, "utf8"));
if (what === "write") {
  const told = JSON.parse(readFileSync(input, "utf8")), data = readFileSync(told.data);
  const whole = new Float64Array(data.buffer.slice(data.byteOffset, data.byteOffset + data.length));
  const column = (name) => told.places[name] && whole.subarray(...told.places[name]);
  writeFileSync(out, logBytes(head, { ...told, column }));
} else {
  const files = JSON.parse(readFileSync(input, "utf8")), answers = [];
  for (const file of files) {
    const bytes = new Uint8Array(readFileSync(file.name)).slice(0, file.cut ?? undefined);
    for (const [at, mask] of file.flips ?? []) bytes[at] ^= mask;
    try {
      const found = readLog(head, bytes);
      const sums = Object.fromEntries(Object.entries(found.columns).map(([name, values]) =>
        [name, Buffer.from(values.buffer).toString("base64")]));
      answers.push({ ...found, columns: file.sums ? sums : {} });
    } catch (error) {
      answers.push({ error: error.message, kind: error.constructor.name });
    }
  }
  writeFileSync(out, JSON.stringify(answers));
}
