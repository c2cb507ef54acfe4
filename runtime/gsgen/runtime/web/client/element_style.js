/** The style of the element's shadow tree: a constructed sheet, which every content policy allows. */

import { remembered } from "./once.js";

const TEXT = `
:host { display: block; position: relative; width: 100%; aspect-ratio: 16 / 9; overflow: hidden;
  background: var(--gsgen-background, #000); color: #fff; font: 14px/1.5 system-ui, sans-serif }
:host([background]) { background: none }
:host([hidden]) { display: none }
canvas, img, video, [part=annotations] { position: absolute; inset: 0; width: 100%; height: 100%; object-fit: cover }
canvas { touch-action: pan-y; outline-offset: -3px }
canvas:focus-visible { outline: 3px solid var(--gsgen-accent, #6cf) }
[part=annotations], video { pointer-events: none; overflow: hidden }
video { height: calc(100% - 2.6rem); object-position: 100vw; object-fit: none }
[part=annotations] > div { position: absolute; top: 0; left: 0 }
::slotted(*), [part=annotation] { pointer-events: auto; transform: translate(-50%, -50%) }
[part=annotations] [part=annotation] { display: block; width: max-content; height: auto; padding: .1rem .5rem; background: #000b; color: #fff }
[part=bar] { position: absolute; left: 0; bottom: 0; height: 3px; width: 0;
  background: var(--gsgen-accent, #6cf); transition: width .2s }
[part=error] { position: absolute; inset: 0; margin: 0; padding: 1rem; display: grid; align-content: center;
  justify-items: center; text-align: center; background: #200c; overflow: auto; white-space: pre-line }
[part=player] { position: absolute; inset: auto 0 0; display: flex; gap: .6rem; padding: .5rem .7rem;
  align-items: center; background: linear-gradient(transparent, #000b); opacity: 0; transition: opacity .2s }
:host(:hover) [part=player], :host(:focus-within) [part=player], [part=player][data-paused] { opacity: 1 }
button { all: unset; cursor: pointer; width: 1.6rem; height: 1.6rem; text-align: center; border-radius: 4px }
button:focus-visible, input:focus-visible { outline: 2px solid var(--gsgen-accent, #6cf) }
input { flex: 1; accent-color: var(--gsgen-accent, #6cf) }
[hidden] { display: none !important }
.status { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%) }
@media (prefers-reduced-motion: reduce) { * { transition: none !important } }
`;

/** @type {WeakMap<Document, CSSStyleSheet>} */
const sheets = new WeakMap();

/** Return the sheet that all elements of a document share. @param {Document} document */
export function elementStyle(document) {
  return remembered(sheets, document, () => {
    const Sheet = /** @type {any} */ (document.defaultView ?? globalThis).CSSStyleSheet;
    const sheet = new Sheet();
    sheet.replaceSync(TEXT);
    return sheet;
  });
}
