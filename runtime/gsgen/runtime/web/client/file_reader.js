/** Reads files in a worker; where a page can have none, on its own thread in slices. */

import { GsgenError } from "./errors.js";

const IDLE_MILLISECONDS = 5000; // after which the worker's memory is given back

/**
 * @typedef {object} Reading
 * @property {import("./row_writer.js").Sink} sink
 * @property {(loaded: number, total: number) => void} progress
 * @property {(result: any) => void} resolve
 * @property {(error: any) => void} reject
 */

/** @type {Map<number, Reading>} */
const readings = new Map();
/** @type {Promise<Worker | null> | null} */
let opening = null;
let idleTimer = 0;
let lastReading = 0;

/** The folder of the client, of which a bundle tells nothing: modules have other addresses in it. */
const FOLDER = /^(https?:.*\/)file_reader\.js(\?.*)?$/.exec(import.meta.url)?.[1];
/** @type {any} */
let policy = null;

/** Open the worker. A page with trusted types allows the policy `gsgen`, or no worker. */
function newWorker() {
  // Bundlers follow this expression as it is written, and pack the module into one file.
  if (!FOLDER) return new Worker(new URL("./bundled_worker.js", import.meta.url), { type: "module" });
  const address = `${FOLDER}reader_worker.js`;
  policy ??= /** @type {any} */ (window).trustedTypes?.createPolicy("gsgen", { createScriptURL: String });
  return new Worker(policy ? policy.createScriptURL(address) : address, { type: "module" });
}

/** Start the worker; null where its module cannot be loaded. @returns {Promise<Worker | null>} */
function openWorker() {
  return new Promise((resolve) => {
    let worker;
    try {
      worker = newWorker();
    } catch {
      resolve(null); // a page from disk, or a client of another origin
      return;
    }
    worker.onerror = () => resolve(null); // a policy of the page forbids it
    worker.onmessage = ({ data: { id, call, args } }) => {
      if (call === "ready") resolve(worker);
      else if (call === "resolve") finish(id, readings.get(id)?.resolve, args[0]);
      else if (call === "reject") finish(id, readings.get(id)?.reject, errorOf(args[0]));
      else if (call === "progress") readings.get(id)?.progress(args[0], args[1]);
      else {
        const taken = () => call === "write" && worker.postMessage({ id });
        Promise.resolve(readings.get(id)?.sink[call](...args)).then(taken, taken);
      }
    };
  });
}

/** Tell the end of a reading, and close the worker if no other begins. */
function finish(id, settle, value) {
  readings.delete(id);
  if (!readings.size) idleTimer = window.setTimeout(closeWorker, IDLE_MILLISECONDS);
  settle?.(value);
}

/** Return the error that a worker described. */
function errorOf({ isOurs, message, stack, ...details }) {
  return isOurs ? Object.assign(new GsgenError("", details), { message }) : Object.assign(new Error(message), { stack });
}

async function closeWorker() {
  const worker = await opening;
  if (readings.size || !worker) return;
  opening = null;
  worker.terminate();
}

/**
 * Read a file; see `readRequest` of splat_files.js. The calls of the sink come in their order.
 * @param {import("./splat_files.js").Request} request
 * @param {import("./row_writer.js").Sink} sink
 * @param {(loaded: number, total: number) => void} [progress]
 * @param {AbortSignal} [signal]
 * @returns {Promise<import("./splat_files.js").FileContent>}
 */
export async function readInBackground(request, sink, progress = () => {}, signal) {
  const worker = await (opening ??= openWorker());
  signal?.throwIfAborted();
  if (!worker) return (await import("./splat_files.js")).readRequest(request, inSlices(sink), progress, signal);
  clearTimeout(idleTimer);
  const id = ++lastReading;
  return new Promise((resolve, reject) => {
    readings.set(id, { sink, progress, resolve, reject });
    worker.postMessage({ id, request });
    signal?.addEventListener("abort", () => {
      if (!readings.has(id)) return;
      worker.postMessage({ id, isAborted: true });
      finish(id, reject, signal.reason);
    });
  });
}

/** Return a sink after whose calls the page can draw and listen. */
function inSlices(sink) {
  const write = async (...words) => {
    await sink.write(...words);
    await new Promise((resolve) => setTimeout(resolve));
  };
  const { begin, grow, end } = sink;
  return { begin, write, grow, end };
}

/**
 * Read the parts of a file of splats into arrays, or else its bytes.
 * @param {import("./splat_files.js").Request} request
 * @param {(loaded: number, total: number) => void} [progress]
 * @param {AbortSignal} [signal]
 */
export async function readParts(request, progress, signal) {
  /** @type {any[]} */
  const parts = [];
  const sink = {
    begin(facts) {
      const { count, channels } = facts;
      return parts.push({ ...facts, rows: new Float32Array(10 * count), appearance: new Float32Array(channels * count) }) - 1;
    },
    write(part, first, rows, appearance) {
      const { channels, ...own } = parts[part];
      const stride = 4 * Math.ceil(channels / 4);
      if (rows) own.rows.set(rows, 10 * first);
      if (stride === channels) return own.appearance.set(appearance, channels * first);
      for (let row = 0; row < appearance.length / stride; row++) {
        own.appearance.set(appearance.subarray(row * stride, row * stride + channels), channels * (first + row));
      }
    },
    grow() {},
    end: (part, count, extent) => Object.assign(parts[part], { count, extent }),
  };
  return { ...(await readInBackground(request, sink, progress, signal)), parts };
}

/** Return the extent of rows. @param {{rows: Float32Array, count: number}} splats */
export async function extentInBackground({ rows, count }) {
  const { extent } = await readInBackground({ name: "", rows, count }, /** @type {any} */ ({}));
  return /** @type {import("./framing.js").Extent} */ (extent);
}
