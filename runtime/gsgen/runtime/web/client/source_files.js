/** The files that elements show, each the same for all that have its address. */

import { inlined } from "./download.js";
import { failing } from "./errors.js";

/** Types that a `<source>` may name. */
const TYPES = {
  "model/ply": true, "application/ply": true, "model/spz": true, "model/sog": true, "model/onnx": true,
  "application/onnx": true, "application/json": true, "application/octet-stream": true, "application/zip": true,
};

/** Return whether pages read files of a type; an empty one may be anything. @param {string} type */
export function canShow(type) {
  return type === "" || type.trim().toLowerCase().split(";")[0] in TYPES;
}

/**
 * Return what an element may show, the best first: its `src`, or `<source>` children of known types.
 * @param {HTMLElement} host
 * @returns {{source: string, element: HTMLSourceElement | null}[]}
 */
export function candidatesOf(host) {
  const source = host.getAttribute("src")?.trim();
  if (source) return [{ source, element: null }];
  const elements = /** @type {HTMLSourceElement[]} */ ([...host.querySelectorAll(":scope > source[src]")]);
  return elements
    .filter(({ type, media }) => canShow(type) && (!media || matchMedia(media).matches))
    .map((element) => ({ source: element.getAttribute("src") ?? "", element }));
}

/** A file that pages show: an address, or bytes. */
export class SourceFile {
  /** @param {string} address @param {ArrayBuffer | Uint8Array | null} [bytes] If they are known. */
  constructor(address, bytes = null) {
    this.address = address;
    this._bytes = bytes;
    this.wasRead = false;
    /** Who reads it, by kernels and target. @type {WeakMap<object, Map<any, any>>} */
    this.readings = new WeakMap();
  }

  /**
   * Return what reads it, at first from the server, then from the browser's cache if that has it.
   * @param {string} name For messages.
   * @param {string} [target] Whose limits rules of generators check.
   * @returns {import("./splat_files.js").Request}
   */
  request(name, target) {
    const { address } = this;
    if (this._bytes) return { name, target, bytes: this._bytes };
    if (address.startsWith("#")) return { name, target, bytes: inlined(address) };
    return { name, target, address, cache: this.wasRead ? "force-cache" : "default" };
  }
}

/** @type {Map<string, WeakRef<SourceFile>>} */
const files = new Map();

/** Return the file of an address, which is the same for all elements, or of a JSON object's text. */
export function sourceFile(source) {
  if (source.startsWith("{")) return new SourceFile(document.baseURI, new TextEncoder().encode(source));
  const isInlined = source.startsWith("#");
  if (!isInlined && !URL.canParse(source, document.baseURI)) failing(source)("is no address");
  const address = isInlined ? source : new URL(source, document.baseURI).href;
  const known = files.get(address)?.deref();
  if (known) return known;
  const file = new SourceFile(address);
  files.set(address, new WeakRef(file));
  return file;
}
