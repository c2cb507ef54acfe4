/** What all elements of a page share: the plans, the device and its compiled kernels. */

import { sharedDevice } from "./device.js";
import { inlined, parsedJson } from "./download.js";
import { KernelCache } from "./host.js";
import { once } from "./once.js";
import { loadPlans } from "./plan.js";

const INLINED_PLANS = "#gsgen-plans"; // an element of pages that are one file

/** Return the plans of this page. */
export const sharedPlans = once(async () => {
  return document.querySelector(INLINED_PLANS) ? parsedJson(inlined(INLINED_PLANS)) : loadPlans();
});

/** Return the kernels of the page's device; the promise is the same until a loss. */
export const sharedKernels = once(
  async () => {
    const [document, device] = await Promise.all([sharedPlans(), sharedDevice()]);
    return new KernelCache(device, document);
  },
  ({ device }) => device.lost,
);
