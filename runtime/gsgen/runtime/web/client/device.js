/** The graphics device of a page, which all elements share. */

import { GsgenError } from "./errors.js";
import { once } from "./once.js";

const WANTED_LIMITS = [
  "maxStorageBufferBindingSize", "maxBufferSize", "maxStorageBuffersPerShaderStage",
  "maxComputeWorkgroupStorageSize", "maxComputeInvocationsPerWorkgroup",
  "maxComputeWorkgroupSizeX", "maxComputeWorkgroupSizeY", "maxComputeWorkgroupSizeZ",
];
const WANTED_FEATURES = /** @type {GPUFeatureName[]} */ (["shader-f16"]); // for generators; no kernel of the renderer needs it

// Milliseconds between attempts: a browser takes seconds to start its graphics process again.
const PAUSES = [0, 250, 500, 1000, 2000, 4000];

let hasWorked = false; // a device of this page

/** This browser or this machine has no WebGPU. */
export class WebGpuMissing extends GsgenError {}

async function requestAdapter() {
  for (const pause of hasWorked ? PAUSES : [0]) {
    if (pause) await new Promise((resolve) => setTimeout(resolve, pause));
    const adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
    if (adapter) return adapter;
  }
  return null;
}

/** Open a device with the adapter's own limits. @returns {Promise<GPUDevice>} */
export async function openDevice() {
  if (!navigator.gpu) {
    throw new WebGpuMissing("this browser has no WebGPU", {
      hint: "Use a current Chrome, Edge, Safari or Firefox, over https or on localhost.",
    });
  }
  const adapter = await requestAdapter();
  if (!adapter) {
    const hint = "Switch hardware acceleration on, or update the graphics driver.";
    if (hasWorked) throw new GsgenError("the graphics device was lost", { hint });
    throw new WebGpuMissing("the browser found no graphics adapter", { hint });
  }
  const requiredLimits = Object.fromEntries(WANTED_LIMITS.map((name) => [name, adapter.limits[name]]));
  const requiredFeatures = WANTED_FEATURES.filter((name) => adapter.features.has(name));
  return adapter.requestDevice({ label: "gsgen", requiredLimits, requiredFeatures });
}

/** Return the page's device; after a loss the next call opens another one. */
export const sharedDevice = once(openDevice, (device) => (hasWorked = true) && device.lost);
