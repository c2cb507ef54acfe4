/**
 * Loads ONNX Runtime Web, and opens sessions on the page's own device.
 *
 * It lies in the folder `ort/` beside this module, or where the page says, or in the page itself.
 */

import { inlined } from "./download.js";
import { GsgenError } from "./errors.js";
import { inTurns, once } from "./once.js";

// Where the browser suspends WebAssembly by itself (JSPI), the smaller build runs.
const HAS_JSPI = "Suspending" in WebAssembly;
const [BUNDLE, WASM] = HAS_JSPI
  ? ["ort.jspi.bundle.min.mjs", "ort-wasm-simd-threaded.jspi.wasm"]
  : ["ort.webgpu.bundle.min.mjs", "ort-wasm-simd-threaded.asyncify.wasm"];
const INLINED = { bundle: "#gsgen-ort", wasm: "#gsgen-ort-wasm" };

/** Set the folder of ONNX Runtime Web. @type {{folder: string | null}} */
export const ortSettings = { folder: null };

async function load() {
  const isInlined = Boolean(document.querySelector(INLINED.bundle));
  const base = document.baseURI.startsWith("http") ? document.baseURI : undefined;
  const given = ortSettings.folder && new URL(ortSettings.folder, base);
  const folder = isInlined ? "" : String(given || new URL("ort/", import.meta.url));
  const address = isInlined
    ? URL.createObjectURL(new Blob([inlined(INLINED.bundle)], { type: "text/javascript" }))
    : new URL(BUNDLE, folder);
  let ort;
  try {
    ort = await import(String(address));
  } catch (error) {
    throw new GsgenError(`ONNX Runtime Web cannot be loaded: ${error.message}`, {
      where: String(address),
      hint: "Copy it beside gsgen.js, into a folder ort: gsgen view --web writes one.",
    });
  }
  ort.env.wasm.numThreads = 1; // more would need headers that isolate the page
  ort.env.logLevel = "error";
  if (isInlined) ort.env.wasm.wasmBinary = inlined(INLINED.wasm);
  else ort.env.wasm.wasmPaths = { wasm: String(new URL(WASM, folder)) };
  return ort;
}

/** Return the module of ONNX Runtime Web. */
export const onnxRuntime = once(load);

/** Run what ONNX Runtime refuses or mixes up at the same time: opening sessions, and frames. */
export const runInTurn = inTurns();

/**
 * Open a session on a device.
 * @param {GPUDevice} device
 * @returns {Promise<any>} The session; null if the model cannot be captured as a graph.
 */
export async function openSession(ort, device, bytes, name, { capture }) {
  // Both are needed: the provider's option is what runs, the setting is what `env` tells.
  ort.env.webgpu.device = device;
  try {
    const options = {
      executionProviders: [{ name: "webgpu", device }],
      preferredOutputLocation: "gpu-buffer",
      enableGraphCapture: capture,
    };
    return await runInTurn(() => ort.InferenceSession.create(bytes, options));
  } catch (refusal) {
    if (capture && /graph capture/i.test(refusal.message)) return null;
    throw new GsgenError(`ONNX Runtime Web refuses the model: ${refusal.message}`, {
      where: name,
      hint: "See what is wrong: gsgen validate MODEL --target webgpu",
    });
  }
}
