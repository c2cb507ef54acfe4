/** Loads bytes: from an address, or from a script element of the same document (`#id`). */

import { ByteSource } from "./byte_source.js";
import { GsgenError, failing } from "./errors.js";

const IMMUTABLE = /-([0-9a-f]{8})(\.glb|\.webp|\/meta\.json)$/; // files of tiles, with the digest of their bytes
const MOST_KEPT = 1000;
const TRANSIENT = [408, 425, 429, 500, 502, 503, 504]; // states that another attempt may not meet

/** Keep a file, if its name has the digest of its bytes: others may be of a date, or no tile. */
async function keep(kept, address, response) {
  const digest = await crypto.subtle.digest("SHA-256", await response.clone().arrayBuffer());
  if (new DataView(digest).getUint32(0) !== parseInt(IMMUTABLE.exec(address)?.[1] ?? "", 16)) return;
  const names = await kept.keys();
  if (names.length >= MOST_KEPT) await kept.delete(names[0]);
  await kept.put(address, response);
}

/** Fetch a file; one whose name changes with its bytes is kept, if the server does not say for how long. */
async function fetched(address, init) {
  const kept = IMMUTABLE.test(address) ? await globalThis.caches?.open("gsgen").catch(() => null) : null;
  const known = await kept?.match(address);
  if (known) return known;
  const response = await fetch(address, init);
  if (!kept || !response.ok || ["Cache-Control", "Expires"].some((name) => response.headers.has(name))) return response;
  keep(kept, address, response.clone()).catch(() => {}); // cut off, or there is no space
  return response;
}

/**
 * Open what lies at an address; its bytes arrive while they are taken.
 * @param {(loaded: number, total: number) => void} [onProgress] The total is 0 if nobody tells it.
 * @param {AbortSignal} [signal]
 * @param {RequestCache} [cache]
 */
export async function openSource(address, name = address, onProgress = () => {}, signal, cache) {
  const fail = (problem, isTransient) => {
    const hint = "Is the address right, and may this page read it (CORS)?";
    throw new GsgenError(`cannot be loaded: ${problem}`, { where: address, hint, isTransient });
  };
  const response = await fetched(address, { signal, cache }).catch((error) => {
    if (signal?.aborted) throw error;
    return fail(error.message, true);
  });
  if (!response.ok) fail(`${response.status} ${response.statusText}`, TRANSIENT.includes(response.status));
  const length = Number(response.headers.get("Content-Length") ?? 0);
  // Packed by the server, a file is longer than its header says; other origins hide whether it is.
  const isPlain = response.type === "basic" && !response.headers.get("Content-Encoding");
  let loaded = 0;
  const counted = new TransformStream({
    transform(piece, controller) {
      loaded += piece.length;
      onProgress(loaded, loaded > length || response.headers.get("Content-Encoding") ? 0 : length);
      controller.enqueue(piece);
    },
  });
  return new ByteSource(response.body.pipeThrough(counted), name, isPlain ? length : 0);
}

/** Return the bytes of an address, or of an element of this page. @returns {Promise<ArrayBuffer>} */
export async function download(address, onProgress = () => {}, signal = /** @type {AbortSignal | undefined} */ (undefined)) {
  if (address.startsWith("#")) return inlined(address);
  const bytes = await (await openSource(address, address, onProgress, signal)).rest();
  return bytes.length === bytes.buffer.byteLength ? bytes.buffer : bytes.slice().buffer;
}

/** Return the value of bytes that are a JSON object; null of other bytes. */
export function parsedJson(data) {
  const bytes = new Uint8Array(data.buffer ?? data, data.byteOffset ?? 0, data.byteLength);
  return bytes[0] === 0x7b ? JSON.parse(new TextDecoder().decode(bytes)) : null;
}

/** Return the bytes of a script element that holds base64. */
export function inlined(source) {
  const element = document.querySelector(source);
  if (!element?.textContent) failing(source)("is no element of this page");
  return Uint8Array.from(atob(element.textContent.trim()), (letter) => letter.charCodeAt(0)).buffer;
}
