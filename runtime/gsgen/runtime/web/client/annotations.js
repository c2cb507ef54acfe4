/**
 * Annotations: children of the element that stand at points of the model.
 *
 * A child with `slot="annotation-NAME"` and `data-position="x y z"` follows its point; it is hidden
 * while the point is behind the camera, or while a `data-normal` looks away from it.
 */

import { eyeOf } from "./camera.js";
import { dot, linearPart, plus, times } from "./matrices.js";

const PREFIX = "annotation";

/** Return three numbers of a text; null of other texts. @param {string | undefined} text */
function pointOf(text) {
  const numbers = (text ?? "").trim().split(/\s*,\s*|\s+/).map((word) => (word ? Number(word) : NaN));
  return numbers.length === 3 && numbers.every(Number.isFinite) ? numbers : null;
}

/** Places the annotations of an element over its picture. */
export class Annotations {
  /**
   * @param {HTMLElement} host
   * @param {HTMLElement} layer Its part that covers the picture.
   * @param {{onChange: () => void, complain: (where: string, problem: string) => void}} callbacks
   */
  constructor(host, layer, { onChange, complain }) {
    this._host = host;
    this._layer = layer;
    this._complain = complain;
    /** @type {{place: HTMLElement, position: number[], normal: number[] | null}[]} */
    this._entries = [];
    this._observer = new MutationObserver(() => {
      this.read();
      onChange();
    });
  }

  /** Follow changes of the element's children. */
  observe() {
    const attributeFilter = ["slot", "data-position", "data-normal", "src", "type", "media"];
    this._observer.observe(this._host, { childList: true, subtree: true, attributes: true, attributeFilter });
    this.read();
  }

  disconnect() {
    this._observer.disconnect();
  }

  /** Read the children again. */
  read() {
    const children = /** @type {HTMLElement[]} */ ([...this._host.children]);
    this._entries = children.filter(({ slot }) => slot.startsWith(PREFIX)).flatMap((child) => {
      const { slot: name, dataset: { position: text, normal } } = child;
      const position = pointOf(text);
      if (!position) {
        this._complain(name, `has data-position="${text ?? ""}", expected x y z`);
        return [];
      }
      const place = document.createElement("div");
      const slot = document.createElement("slot");
      slot.name = name;
      place.append(slot);
      return [{ place, position, normal: pointOf(normal) }];
    });
    this._layer.replaceChildren(...this._entries.map(({ place }) => place));
    this._layer.hidden = !this._entries.length;
  }

  /** Place all for a camera. @param {import("./camera.js").Camera} camera */
  place(camera) {
    const { view, fx, fy, cx, cy, width, height, near } = camera;
    for (const { place, position, normal } of this._entries) {
      const [x, y, z] = plus(times(linearPart(view), position), 1, [view[3], view[7], view[11]]);
      const looksAway = normal && dot(normal, plus(eyeOf(camera), -1, position)) < 0;
      place.hidden = !(z > near) || Boolean(looksAway);
      const share = [(cx + (fx * x) / z) / width, (cy + (fy * y) / z) / height];
      if (!place.hidden) [place.style.left, place.style.top] = share.map((part) => `${100 * part}%`);
    }
  }
}
