// Runs a page's rig as the page does, with its own worker, columns and digest.
import fs from "node:fs";
import { judge } from "../../../../tools/make/web/page/judge.js";
import { Run, contents } from "../../../../tools/make/web/page/run.js";

const asked = JSON.parse(fs.readFileSync(0)), text = fs.readFileSync(asked.page, "utf8");
const part = (id) => text.match(new RegExp(`id="${id}">([^]*?)</script>`))[1];
const { about, module } = await contents(part("payload"));
const results = [];
for (const { controller, seed, values = {}, at = 0, then = {}, flip } of asked.runs) {
  const chosen = about.controllers.find(({ name }) => name === controller), run = new Run(chosen, about.nodes, about.period_s);
  const code = module(chosen.module);
  if (flip) new Uint8Array(code)[flip] ^= 1;
  let why = "";
  const heard = (data) => { why ||= data.why ?? ""; if (data.parts) run.take(data.parts); };
  const post = new Function("postMessage", `${part("worker")}\nreturn (data) => onmessage({ data });`)(heard);
  const placed = (given) => Object.entries(given).map(([key, value]) => {
    const one = chosen.values.find((each) => each.name === key);
    return [about.nodes.indexOf(one.node), one.at, value];
  });
  await post({
    kind: "start", module: code, columns: about.nodes.map((node) => chosen.columns[node].length), cycles: chosen.cycles,
    periodS: about.period_s, values: [...(chosen.seeds[seed] ?? []), ...placed(values)],
  });
  if (!why) {
    await post({ kind: "step", cycles: at });
    await post({ kind: "set", id: 1, values: placed(then) });
    await post({ kind: "step", cycles: chosen.cycles });
  }
  const verdict = why ? null : judge(chosen.judge, (name) => run.record(name), run.done, about.period_s);
  results.push({ digest: why ? "" : await run.digest(), native: chosen.digest, counts: run.counts, why, verdict, odd: run.odd() });
}
console.log(JSON.stringify(results));
