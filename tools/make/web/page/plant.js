// The plant of a run, drawn at its newest cycle.
import { paint } from "./drawing.js";
import { sceneOf } from "./scene.js";
import { byId } from "./view.js";

export class Plant {
  shown(run) {
    this.run = run;
    this.data = run.controller.drawing;
    byId("drawing-box").hidden = this.data.why !== undefined;
  }

  // `changed`: settings of the plant that are not the rig's.
  draw(changed) {
    if (this.data.why !== undefined) return;
    const at = Math.max(this.run.done - 1, 0), values = { t: at * this.run.periodS };
    for (const [name, source] of Object.entries(this.data.needs)) values[name] = this.run.place(source)?.values[at];
    const scene = sceneOf(this.data, values, changed, this.run.done > 0);
    paint(byId("drawing"), scene);
    const words = scene.shapes.filter(([kind]) => kind === "text").map(([, , , text]) => text);
    byId("drawing").setAttribute("aria-label", ["drawing of the plant", ...words, scene.note].filter(Boolean).join("; "));
  }
}
