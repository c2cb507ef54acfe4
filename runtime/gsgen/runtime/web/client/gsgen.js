/** Defines `<gsgen-model>`. */

import { GsgenModel } from "./element.js";

if (!customElements.get("gsgen-model")) customElements.define("gsgen-model", GsgenModel);

export { GsgenModel };
export { GsgenError } from "./errors.js";
