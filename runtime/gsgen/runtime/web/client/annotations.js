/**
 * Annotations: children of the element that stand at points of the model, and those of scene files.
 *
 * A child with `slot="annotation-NAME"` and `data-position="x y z"` follows its point; it is hidden
 * while the point is behind the camera, or while a `data-normal` looks away from it.
 */

import { eyeOf } from "./camera.js";
import { dot, moved, plus } from "./matrices.js";
import { numbersIn } from "./words.js";

const PREFIX = "annotation";

/** Return three numbers of a text; null of other texts. @param {string | undefined} text */
function pointOf(text) {
  const numbers = numbersIn(text ?? "");
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
    /** @type {typeof this._entries} Of the scene file. */
    this._written = [];
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
    this._arrange();
  }

  /**
   * Show the annotations of a scene file.
   * @param {import("./scene_file.js").SceneAnnotation[]} annotations
   * @param {(camera: any) => void} look Called with the camera of one that is clicked.
   */
  write(annotations, look) {
    this._written = annotations.map(({ position, normal, text, camera }) => {
      const label = document.createElement(camera ? "button" : "span");
      label.part.add("annotation");
      label.textContent = text;
      if (camera) label.addEventListener("click", () => look(camera));
      const place = document.createElement("div");
      place.append(label);
      return { place, position, normal };
    });
    this._arrange();
  }

  _arrange() {
    const places = [...this._entries, ...this._written].map(({ place }) => place);
    this._layer.replaceChildren(...places);
    this._layer.hidden = !places.length;
  }

  /** Place all for a camera. @param {import("./camera.js").Camera} camera */
  place(camera) {
    const { view, fx, fy, cx, cy, width, height, near } = camera;
    for (const { place, position, normal } of [...this._entries, ...this._written]) {
      const [x, y, z] = moved(view, position);
      const looksAway = normal && dot(normal, plus(eyeOf(camera), -1, position)) < 0;
      place.hidden = !(z > near) || Boolean(looksAway);
      const share = [(cx + (fx * x) / z) / width, (cy + (fy * y) / z) / height];
      if (!place.hidden) [place.style.left, place.style.top] = share.map((part) => `${100 * part}%`);
    }
  }
}
