/** Defines `<gsgen-model>`. */

import { GsgenModel } from "./element.js";

// Servers import the module, and have no elements.
if (globalThis.customElements && !customElements.get("gsgen-model")) customElements.define("gsgen-model", GsgenModel);

export { GsgenModel };
export { GsgenError } from "./errors.js";
export { ortSettings } from "./onnx_runtime.js";
