/** The base of elements whose attributes are properties, and which tell what is wrong with them. */

import { ATTRIBUTES, propertyOf } from "./attributes.js";
import { nearestWord } from "./words.js";

/**
 * The properties that reflect attributes.
 * @typedef {object} ReflectedAttributes
 * @property {string} src Address of the model.
 * @property {string} alt What a screen reader says of the model.
 * @property {string} name The file's name, for messages.
 * @property {string} poster Address of a picture that is shown until the model is.
 * @property {string} images Addresses of the pictures that a generator computes its Gaussians from.
 * @property {string} posts Addresses of post-process models that the picture goes through.
 * @property {string} imageCameras Address of a file of the cameras of these pictures.
 * @property {"eager" | "lazy"} loading
 * @property {boolean} cameraControls Whether visitors turn the camera.
 * @property {boolean} fileDrop Whether visitors drop files.
 * @property {boolean} autoplay
 * @property {boolean} loop
 * @property {number | null} time Value of the model's time at the start.
 * @property {string} cameraOrbit Azimuth, elevation (degrees) and distance of the first camera.
 * @property {string} cameraTarget The point that the first camera looks at.
 * @property {string} minCameraOrbit
 * @property {string} maxCameraOrbit
 * @property {number} fieldOfView Vertical, in degrees.
 * @property {boolean} autoRotate
 * @property {number} rotationPerSecond Degrees.
 * @property {string} up The world's upward axis, such as `-y`.
 * @property {string} background
 * @property {number} minRenderScale Of width and height, of slow frames that change; 1 is all pixels.
 * @property {"color" | "depth" | "median" | "normal" | "alpha"} mode
 * @property {"webgpu" | "core" | "gsgen" | "visionary"} target Whose limits generators are checked for.
 * @property {number | null} maxError Of tilesets, in pixels.
 * @property {number | null} maxSplats Of tilesets.
 */
/** @typedef {{where: string, message: string}} Warning */

// Servers import the module, and have no elements.
const Element = globalThis.HTMLElement ?? /** @type {typeof HTMLElement} */ (class {});

export class Attributed extends Element {
  static observedAttributes = Object.keys(ATTRIBUTES);

  constructor() {
    super();
    /** What is wrong with the element's attributes, properties and inputs. @type {Warning[]} */
    this.warnings = [];
    /** @type {Record<string, any>} */
    this._values = {};
  }

  connectedCallback() {
    // Properties that a framework set before this class was loaded hide those of the class.
    for (const name of Object.keys(this)) {
      if (!(name in Object.getPrototypeOf(this))) continue;
      const value = this[name];
      delete this[name];
      this[name] = value;
    }
    const [attributes, properties] = [Object.keys(ATTRIBUTES), Object.keys(ATTRIBUTES).map(propertyOf)];
    for (const name of this.getAttributeNames()) this._checkWord(name, attributes, "attribute");
    for (const name of Object.keys(this)) this._checkWord(name, properties, "property");
  }

  /** Tell that a name is not known, if it looks like one that is. */
  _checkWord(name, words, what) {
    const nearest = words.includes(name) || name.startsWith("_") ? undefined : nearestWord(name, words);
    if (nearest) this._complain(name, `is no ${what}; is ${nearest} meant?`);
  }

  attributeChangedCallback(name, before, now) {
    if (before === now) return;
    const { fallback, parse } = ATTRIBUTES[name];
    const complain = (problem) => this._complain(name, `"${now}" ${problem}`);
    this._values[name] = now === null ? fallback : (parse(now, complain) ?? fallback);
  }

  /** Return the parsed value of an attribute. */
  _valueOf(name) {
    return this._values[name] ?? ATTRIBUTES[name].fallback;
  }

  /** Tell once what is wrong: in the console, by the event `warning`, and in `warnings`. */
  _complain(where, message) {
    if (this.warnings.some((known) => known.where === where && known.message === message)) return;
    const detail = { where, message };
    this.warnings.push(detail);
    console.warn(`${this.localName}: ${where} ${message}`);
    // Whoever made the element can listen before the event comes.
    queueMicrotask(() => this.dispatchEvent(new CustomEvent("warning", { detail })));
  }
}

for (const [name, { reflects }] of Object.entries(ATTRIBUTES)) {
  Object.defineProperty(Attributed.prototype, propertyOf(name), {
    configurable: true,
    enumerable: true,
    get() {
      const written = this.getAttribute(name);
      if (reflects === "presence") return written !== null;
      if (reflects === "written") return written ?? "";
      if (reflects === "parsed") return this._valueOf(name);
      if (!written || !URL.canParse(written, document.baseURI)) return written ?? "";
      return new URL(written, document.baseURI).href;
    },
    set(value) {
      if (reflects === "presence") this.toggleAttribute(name, Boolean(value));
      else if (value === null || value === undefined) this.removeAttribute(name);
      else this.setAttribute(name, String(value));
    },
  });
}

/** @type {{new (): Attributed & ReflectedAttributes, observedAttributes: string[]}} */
export const AttributedElement = /** @type {any} */ (Attributed);
