/** What all elements of a page share: the plans, the device and its compiled kernels. */

import { sharedDevice } from "./device.js";
import { inlined } from "./download.js";
import { KernelCache } from "./host.js";
import { loadPlans } from "./plan.js";

const INLINED_PLANS = "#gsgen-plans"; // an element of pages that are one file

/** @type {Promise<import("./plan.js").PlanDocument> | null} */
let plans = null;
/** @type {WeakMap<GPUDevice, KernelCache>} */
const caches = new WeakMap();

/** @returns {Promise<import("./plan.js").PlanDocument>} */
function sharedPlans() {
  if (!plans) {
    plans = document.querySelector(INLINED_PLANS)
      ? Promise.resolve(JSON.parse(new TextDecoder().decode(inlined(INLINED_PLANS))))
      : loadPlans();
    plans.catch(() => {
      plans = null;
    });
  }
  return plans;
}

/** Return the kernels of the page's device. @returns {Promise<KernelCache>} */
export async function sharedKernels() {
  const [document, device] = await Promise.all([sharedPlans(), sharedDevice()]);
  let kernels = caches.get(device);
  if (!kernels) {
    kernels = new KernelCache(device, document);
    caches.set(device, kernels);
  }
  return kernels;
}
