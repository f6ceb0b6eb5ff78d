// What an operator does to a run: arm, hold, and who is in charge; only what means something now.

import { el } from "./panels.js";

export class Operate {
  constructor(box, act) { this.box = box; this.ask = act; this.told = ""; }

  shown(about) { this.about = about; this.told = ""; this.box.replaceChildren(); }

  status({ executive }) {
    if (!executive) return;
    const { state, armed, in_charge: charge } = executive;
    const told = JSON.stringify([state, armed, charge]);
    if (told === this.told) return;
    this.told = told;
    const found = [];
    if (armed && ["READY", "RUN", "HOLD"].includes(state)) found.push(this.button("hold", { do: "act", what: "hold" }));
    if (!armed && state === "READY") found.push(this.button("arm", { do: "act", what: "arm" }));
    if (state !== "STOP" && state !== "ended") {
      for (const name of this.about.laws.filter((one) => one !== charge)) {
        found.push(this.button(`hand over to ${name}`, { do: "handover", controller: name }));
      }
    }
    if (charge) found.push(el("span", "quiet", `${charge} is in charge`));
    this.box.replaceChildren(...found.flatMap((one) => [one, " "]));
  }

  button(text, message) {
    const button = el("button", "", text);
    button.disabled = !this.about.write;
    button.onclick = () => this.ask(message, text);
    return button;
  }
}
