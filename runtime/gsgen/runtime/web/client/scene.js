/**
 * Defines `<gsgen-scene>`: several models in one world, of a scene file or of its children.
 *
 * A child `<gsgen-model src>` or `<gsgen-mesh src>` may have `position`, `rotation` (a quaternion w x y
 * z), `scale`, `opacity` and `hidden`; a model values of inputs in its property `inputs`, a mesh
 * `shading` and `animation`.
 */

import { GsgenModel } from "./gsgen.js";
import { Stage } from "./stage.js";
import { numbersIn } from "./words.js";

/** The fields of a model or mesh in scene files by the attributes of a child, with their least numbers. */
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

  /** The scene file of what is shown, with the camera as it stands. */
  toJSON() {
    const { stage, orbit, _shown: shown } = this;
    const [width, height] = this._size();
    if (!stage || !orbit || !shown) return null;
    const camera = width && height ? shown.orbit.camera(width, height) : (shown.camera ?? undefined);
    const document = stage.toJSON(camera, orbit);
    const posts = [...(document.posts ?? []), ...this._valueOf("posts")];
    return { ...document, ...(posts.length ? { posts } : {}), background: this._look().background };
  }

  _candidates() {
    if (this.hasAttribute("src")) return super._candidates();
    const [models, meshes] = ["gsgen-model", "gsgen-mesh"].map((tag) => {
      const children = /** @type {GsgenModel[]} */ ([...this.querySelectorAll(`:scope > ${tag}[src]`)]);
      return children.map((child) => this._partOf(child));
    });
    if (!models.length && !meshes.length) return super._candidates();
    return [{ source: JSON.stringify({ models, meshes, up: "-y" }), element: null }];
  }

  /** Return a child as a model or mesh of a scene file. */
  _partOf(child) {
    const part = { path: new URL(child.getAttribute("src") ?? "", document.baseURI).href };
    for (const [attribute, [field, length]] of Object.entries(PLACES)) {
      const text = child.getAttribute(attribute);
      if (text === null) continue;
      const numbers = numbersIn(text);
      const isGood = numbers.every(Number.isFinite) && (numbers.length === length || (attribute === "scale" && numbers.length === 3));
      if (isGood) part[field] = numbers.length === 1 ? numbers[0] : numbers;
      else this._complain(attribute, `"${text}" of a child is not ${length} numbers`);
    }
    for (const name of ["shading", "animation"]) if (child.hasAttribute(name)) part[name] = child.getAttribute(name);
    if (child.hidden) part.visible = false;
    return child.inputs ? { ...part, inputs: { ...child.inputs } } : part;
  }
}

// Servers import the module, and have no elements.
if (globalThis.customElements && !customElements.get("gsgen-scene")) customElements.define("gsgen-scene", GsgenScene);

export { Stage };
