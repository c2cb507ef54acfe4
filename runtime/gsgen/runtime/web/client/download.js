/** Loads bytes: from an address, or from a script element of the same document (`#id`). */

import { GsgenError } from "./errors.js";

/**
 * @param {string} source
 * @param {(loaded: number, total: number) => void} [onProgress] The total is 0 if nobody tells it.
 * @param {AbortSignal} [signal]
 * @returns {Promise<ArrayBuffer>}
 */
export async function download(source, onProgress = () => {}, signal) {
  if (source.startsWith("#")) return inlined(source);
  let response;
  try {
    response = await fetch(source, { signal });
  } catch (error) {
    if (signal?.aborted) throw error;
    const hint = "Is the address right, and may this page read it (CORS)?";
    throw new GsgenError(`cannot be loaded: ${error.message}`, { where: source, hint });
  }
  if (!response.ok || !response.body) {
    throw new GsgenError(`cannot be loaded: ${response.status} ${response.statusText}`, {
      where: source,
      hint: "Is the address right?",
    });
  }
  const total = Number(response.headers.get("Content-Length") ?? 0);
  const parts = [];
  let loaded = 0;
  const reader = response.body.getReader();
  for (let { done, value } = await reader.read(); !done; { done, value } = await reader.read()) {
    parts.push(value);
    loaded += value.length;
    onProgress(loaded, total);
  }
  return new Blob(parts).arrayBuffer();
}

/** Return the bytes of a script element that holds base64. */
export function inlined(source) {
  const element = document.querySelector(source);
  if (!element?.textContent) {
    throw new GsgenError("is no element of this page", { where: source });
  }
  return Uint8Array.from(atob(element.textContent.trim()), (letter) => letter.charCodeAt(0)).buffer;
}
