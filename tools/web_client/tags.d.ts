/// <reference types="@webgpu/types" />
import type { GsgenModel } from "./element.js";

declare global {
  interface HTMLElementTagNameMap {
    "gsgen-model": GsgenModel;
  }
}
