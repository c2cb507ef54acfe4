/// <reference types="@webgpu/types" />
import type { GsgenModel } from "./element.js";

type ErrorDetail = { rule: string; where: string; message: string; hint: string };
type Empty = Record<string, never>;

/** The events of the element beside those of all elements. */
export interface GsgenModelEventMap {
  load: CustomEvent<{ count: number }>;
  recover: CustomEvent<{ count: number }>;
  progress: CustomEvent<{ loaded: number; total: number }>;
  error: CustomEvent<ErrorDetail>;
  warning: CustomEvent<{ where: string; message: string }>;
  statechange: CustomEvent<{ state: GsgenModel["state"] }>;
  timeupdate: CustomEvent<{ currentTime: number }>;
  play: CustomEvent<Empty>;
  pause: CustomEvent<Empty>;
  ended: CustomEvent<Empty>;
  ratechange: CustomEvent<Empty>;
  "camera-change": CustomEvent<Empty>;
}

declare module "./element.js" {
  interface GsgenModel {
    addEventListener<K extends keyof GsgenModelEventMap>(
      type: K,
      listener: (this: GsgenModel, event: GsgenModelEventMap[K]) => void,
      options?: boolean | AddEventListenerOptions,
    ): void;
    addEventListener(
      type: string,
      listener: EventListenerOrEventListenerObject,
      options?: boolean | AddEventListenerOptions,
    ): void;
  }
}

declare global {
  interface HTMLElementTagNameMap {
    "gsgen-model": GsgenModel;
  }
}
