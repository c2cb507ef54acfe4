/**
 * Defines `<gsgen-scene>`: several models in one world, of a scene file or of its children.
 *
 * A child `<gsgen-model src>` may have `position`, `rotation` (a quaternion w x y z), `scale` and
 * `opacity`, and values of inputs in its property `inputs`.
 */

import { GsgenModel } from "./gsgen.js";
import { Stage } from "./stage.js";

/** The fields of a model in scene files by the attributes of a child, with their least numbers. */
const PLACES = {
  position: ["translate", 3],
  rotation: ["rotate", 4],
  scale: ["scale", 1],
  opacity: ["opacity_scale", 1],
};

export class GsgenScene extends GsgenModel {
  /** The stage that is shown, whose entries may be moved: then ask for a frame. @returns {Stage | null} */
  get stage() {
    const model = this._shown?.model;
    return model instanceof Stage ? model : null;
  }

  /** The scene file of what is shown, with the camera of the last frame. */
  toJSON() {
    const { stage, orbit, camera } = this;
    if (!stage || !orbit || !camera) return null;
    return { ...stage.toJSON(camera, orbit), background: this._look().background };
  }

  _candidates() {
    const children = /** @type {GsgenModel[]} */ ([...this.querySelectorAll(":scope > gsgen-model[src]")]);
    if (this.hasAttribute("src") || !children.length) return super._candidates();
    const models = children.map((child) => this._modelOf(child));
    return [{ source: JSON.stringify({ models, up: "-y" }), element: null }];
  }

  /** Return a child as a model of a scene file. */
  _modelOf(child) {
    const model = { path: new URL(child.getAttribute("src") ?? "", document.baseURI).href };
    for (const [attribute, [field, length]] of Object.entries(PLACES)) {
      const text = child.getAttribute(attribute);
      if (text === null) continue;
      const numbers = text.trim().split(/\s*,\s*|\s+/).map((word) => (word ? Number(word) : NaN));
      const isGood = numbers.every(Number.isFinite) && (numbers.length === length || (attribute === "scale" && numbers.length === 3));
      if (isGood) model[field] = numbers.length === 1 ? numbers[0] : numbers;
      else this._complain(attribute, `"${text}" of a child is not ${length} numbers`);
    }
    return child.inputs ? { ...model, inputs: { ...child.inputs } } : model;
  }
}

// Servers import the module, and have no elements.
if (globalThis.customElements && !customElements.get("gsgen-scene")) customElements.define("gsgen-scene", GsgenScene);

export { Stage };
