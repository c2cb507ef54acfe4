/** The files that elements show: each address is downloaded once, and kept while an element has it. */

import { downloadBlob, inlined } from "./download.js";
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

/** The bytes of an address. */
export class SourceFile {
  /** @param {string} address @param {Blob | null} [blob] The bytes, if they are known. */
  constructor(address, blob = null) {
    this.address = address;
    this._blob = blob;
    /** @type {Promise<Blob> | null} */
    this._loading = null;
    this._stop = () => {};
    /** @type {Set<(loaded: number, total: number) => void>} */
    this._readers = new Set();
  }

  /**
   * Return the bytes; the first call downloads them.
   * @param {(loaded: number, total: number) => void} onProgress
   * @param {AbortSignal} signal The download ends when all who wait for it have left.
   */
  async bytes(onProgress, signal) {
    if (this.address.startsWith("#")) return inlined(this.address);
    if (this._blob) return this._blob.arrayBuffer();
    const leave = () => {
      this._readers.delete(onProgress);
      if (!this._readers.size) this._stop();
    };
    this._readers.add(onProgress);
    signal.addEventListener("abort", leave, { once: true });
    const loading = (this._loading ??= this._download());
    try {
      this._blob = await loading;
      signal.throwIfAborted();
      return await this._blob.arrayBuffer();
    } catch (error) {
      if (this._loading === loading) this._loading = null; // the next call tries again
      throw error;
    } finally {
      signal.removeEventListener("abort", leave);
      this._readers.delete(onProgress);
    }
  }

  _download() {
    const stop = new AbortController();
    this._stop = () => {
      stop.abort();
      this._loading = null;
    };
    const tell = (loaded, total) => this._readers.forEach((onProgress) => onProgress(loaded, total));
    return downloadBlob(this.address, tell, stop.signal);
  }
}

/** @type {Map<string, WeakRef<SourceFile>>} */
const files = new Map();

/** Return the file of an address, which is the same for all elements, or of a JSON object's text. */
export function sourceFile(source) {
  if (source.startsWith("{")) return new SourceFile(document.baseURI, new Blob([source]));
  const isInlined = source.startsWith("#");
  if (!isInlined && !URL.canParse(source, document.baseURI)) failing(source)("is no address");
  const address = isInlined ? source : new URL(source, document.baseURI).href;
  const known = files.get(address)?.deref();
  if (known) return known;
  const file = new SourceFile(address);
  files.set(address, new WeakRef(file));
  return file;
}
