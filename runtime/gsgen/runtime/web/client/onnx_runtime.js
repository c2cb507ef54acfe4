/**
 * Loads ONNX Runtime Web, and opens sessions on the page's own device.
 *
 * It lies in the folder `ort/` beside this module, or where the page says, or in the page itself.
 */

import { inlined } from "./download.js";
import { failing } from "./errors.js";
import { inTurns, once } from "./once.js";

const HAS_JSPI = "Suspending" in WebAssembly;
const INLINED = { bundle: "#gsgen-ort", wasm: "#gsgen-ort-wasm" };
const EMPTY_MODULE = Uint8Array.of(0, 0x61, 0x73, 0x6d, 1, 0, 0, 0);

/**
 * Where ONNX Runtime Web comes from, if not from the folder `ort` beside this module.
 * @type {{folder: string | null, load: (() => Promise<any>) | null}} The address of a folder, or a
 *     function that imports the module: `() => import("onnxruntime-web/webgpu")`.
 */
export const ortSettings = { folder: null, load: null };

/** Return the addresses of the module and of its WebAssembly. */
function addresses() {
  if (document.querySelector(INLINED.bundle)) {
    const blob = new Blob([inlined(INLINED.bundle)], { type: "text/javascript" });
    return [URL.createObjectURL(blob), null];
  }
  // Where the browser suspends WebAssembly by itself (JSPI), the smaller build runs. Bundlers follow
  // these addresses, as each is written out; webpack would refuse a folder that is not there.
  const own = HAS_JSPI
    ? [
        new URL(/* webpackIgnore: true */ "./ort/ort.jspi.bundle.min.mjs", import.meta.url),
        new URL(/* webpackIgnore: true */ "./ort/ort-wasm-simd-threaded.jspi.wasm", import.meta.url),
      ]
    : [
        new URL(/* webpackIgnore: true */ "./ort/ort.webgpu.bundle.min.mjs", import.meta.url),
        new URL(/* webpackIgnore: true */ "./ort/ort-wasm-simd-threaded.asyncify.wasm", import.meta.url),
      ];
  if (!ortSettings.folder) return own.map(String);
  const folder = new URL(ortSettings.folder.replace(/\/?$/, "/"), document.baseURI);
  const names = own.map(({ pathname }) => pathname.slice(pathname.lastIndexOf("/") + 1));
  return names.map((name) => String(new URL(name, folder)));
}

/** Throw if the page's policy forbids WebAssembly, for which no model is to blame. */
function requireWebAssembly() {
  try {
    new WebAssembly.Module(EMPTY_MODULE);
  } catch (error) {
    failing("", "Add 'wasm-unsafe-eval' to script-src of its Content-Security-Policy.")(`this page may not run WebAssembly: ${error.message}`);
  }
}

async function load() {
  requireWebAssembly();
  if (ortSettings.load) return configured(await ortSettings.load(), null);
  const [address, wasm] = addresses();
  try {
    return configured(await import(/* @vite-ignore */ /* webpackIgnore: true */ String(address)), wasm);
  } catch (error) {
    const hint = "Copy it beside gsgen.js, into a folder ort: gsgen view --web writes one.";
    return failing(String(address), hint)(`ONNX Runtime Web cannot be loaded: ${error.message}`);
  }
}

/** Return the module with its settings. @param {string | null} wasm Address of its WebAssembly. */
function configured(ort, wasm) {
  ort.env.wasm.numThreads = 1; // more would need headers that isolate the page
  ort.env.logLevel = "error";
  if (document.querySelector(INLINED.wasm)) ort.env.wasm.wasmBinary = inlined(INLINED.wasm);
  else if (wasm) ort.env.wasm.wasmPaths = { wasm };
  return ort;
}

/** Return the module of ONNX Runtime Web. */
export const onnxRuntime = once(load);

/** Run what ONNX Runtime refuses or mixes up at the same time: opening sessions, and frames. */
export const runInTurn = inTurns();

/**
 * Open a session on a device, whose outputs stay in its buffers.
 * @param {GPUDevice} device
 * @returns {Promise<any>} The session; null if the model cannot be captured as a graph.
 */
export async function openSession(ort, device, bytes, name, capture, /** Of open dimensions. @type {Record<string, number>} */ sizes = {}) {
  // Both are needed: the provider's option is what runs, the setting is what `env` tells.
  ort.env.webgpu.device = device;
  const options = {
    executionProviders: [{ name: "webgpu", device }],
    preferredOutputLocation: "gpu-buffer",
    enableGraphCapture: capture,
    freeDimensionOverrides: sizes,
  };
  return createSession(ort, bytes, name, options, (refusal) => capture && /graph capture/i.test(refusal));
}

/** Create a session; return null where an error is expected. @param {(message: string) => boolean} [isExpected] */
export async function createSession(ort, bytes, name, options, isExpected = () => false) {
  try {
    return await runInTurn(() => ort.InferenceSession.create(bytes, options));
  } catch (refusal) {
    if (isExpected(refusal.message)) return null;
    const hint = "See what is wrong: gsgen validate MODEL --target webgpu";
    return failing(name, hint)(`ONNX Runtime Web refuses the model: ${refusal.message}`);
  }
}
