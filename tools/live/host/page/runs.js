// Which run is shown, where several go on; what was chosen is kept for this tab, also across a reconnect.

import { el } from "./panels.js";

const by = (id) => document.getElementById(id);
const KEPT = "pcpc run";

export const chosen = () => sessionStorage.getItem(KEPT) ?? "";

export class Runs {
  constructor(page) {
    this.page = page; this.offered = []; this.shown = "";
    by("runs").onchange = (event) => this.choose(event.target.value);
  }

  // Runs came or went, changed their states, or another one is shown.
  heard({ runs, shown }) {
    this.offered = runs; this.shown = shown;
    const names = runs.map((one) => one.run);
    if (chosen() && !names.includes(chosen())) names.push(chosen());
    if (shown && !names.includes(shown)) names.push(shown);
    const several = names.length > 1;
    by("runs-box").hidden = !several;
    by("runs").replaceChildren(...names.map((name) => new Option(this.text(name), name, false, name === shown)));
    if (!shown) by("runs").selectedIndex = -1;
    this.ask(!shown && runs.length > 0 && (several || chosen() !== ""));
  }

  text(name) { return this.offered.some((one) => one.run === name) ? name : `${name} (does not run)`; }

  ask(open) {
    by("chooser").hidden = !open;
    if (!open) return;
    const gone = chosen() ? `${chosen()} does not run; ` : "";
    const count = this.offered.length;
    by("chooser-title").textContent = `${gone}${count === 1 ? "another run is in progress" : `${count} runs are in progress`}; choose one`;
    by("chooser-runs").replaceChildren(...this.offered.map((one) => {
      const button = el("button", "", one.run);
      button.onclick = () => this.choose(one.run);
      const states = Object.entries(one.nodes).map(([role, state]) => `${role} ${state}`).join(", ");
      const since = new Date(1000 * one.since_s).toLocaleTimeString();
      const row = el("tr");
      row.append(...[button, one.rig, `since ${since}`, states].map((what) => {
        const cell = el("td"); cell.append(what); return cell;
      }));
      return row;
    }));
  }

  choose(run) {
    sessionStorage.setItem(KEPT, run);
    this.page.net.ask({ do: "run", run }).then((told) => { if (told.why) this.page.notice(told.why); });
  }
}
