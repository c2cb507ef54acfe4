/** Loads bytes: from an address, or from a script element of the same document (`#id`). */

import { failing } from "./errors.js";

/**
 * @param {(loaded: number, total: number) => void} [onProgress] The total is 0 if nobody tells it.
 * @param {AbortSignal} [signal]
 * @returns {Promise<ArrayBuffer>}
 */
export async function download(source, onProgress = () => {}, signal) {
  return source.startsWith("#") ? inlined(source) : (await downloadBlob(source, onProgress, signal)).arrayBuffer();
}

/**
 * @param {(loaded: number, total: number) => void} onProgress
 * @param {AbortSignal} [signal]
 */
export async function downloadBlob(source, onProgress, signal) {
  const fail = failing(source, "Is the address right, and may this page read it (CORS)?");
  let response;
  try {
    response = await fetch(source, { signal });
  } catch (error) {
    if (signal?.aborted) throw error;
    fail(`cannot be loaded: ${error.message}`);
  }
  if (!response.ok) fail(`cannot be loaded: ${response.status} ${response.statusText}`);
  // The length is that of the packed bytes, which is unlike that of those which arrive.
  const isPacked = response.headers.has("Content-Encoding");
  const total = isPacked ? 0 : Number(response.headers.get("Content-Length") ?? 0);
  const parts = [];
  let loaded = 0;
  const reader = response.body.getReader();
  for (let { done, value } = await reader.read(); !done; { done, value } = await reader.read()) {
    parts.push(value);
    loaded += value.length;
    onProgress(loaded, loaded <= total ? total : 0);
  }
  return new Blob(parts);
}

/** Return the value of bytes that are a JSON object; null of other bytes. */
export function parsedJson(data) {
  return new Uint8Array(data)[0] === 0x7b ? JSON.parse(new TextDecoder().decode(data)) : null;
}

/** Return the bytes of a script element that holds base64. */
export function inlined(source) {
  const element = document.querySelector(source);
  if (!element?.textContent) failing(source)("is no element of this page");
  return Uint8Array.from(atob(element.textContent.trim()), (letter) => letter.charCodeAt(0)).buffer;
}
