/** What all elements of a page share: the plans, the device and its compiled kernels. */

import { sharedDevice } from "./device.js";
import { inlined, parsedJson } from "./download.js";
import { KernelCache } from "./host.js";
import { once, remembered } from "./once.js";
import { loadPlans } from "./plan.js";

const INLINED_PLANS = "#gsgen-plans"; // an element of pages that are one file

/** @type {WeakMap<GPUDevice, KernelCache>} */
const caches = new WeakMap();

/** Return the plans of this page. */
export const sharedPlans = once(async () => {
  return document.querySelector(INLINED_PLANS) ? parsedJson(inlined(INLINED_PLANS)) : loadPlans();
});

/** Return the kernels of the page's device. @returns {Promise<KernelCache>} */
export async function sharedKernels() {
  const [document, device] = await Promise.all([sharedPlans(), sharedDevice()]);
  return remembered(caches, device, () => new KernelCache(device, document));
}
