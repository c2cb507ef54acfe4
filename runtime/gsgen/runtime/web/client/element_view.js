/** The shadow tree of the element: canvas, poster, progress, player, and texts. */

const STYLE = `
:host { display: block; position: relative; width: 100%; aspect-ratio: 16 / 9; overflow: hidden;
  background: var(--gsgen-background, #000); color: #fff; font: 14px/1.5 system-ui, sans-serif }
:host([hidden]) { display: none }
canvas, img { position: absolute; inset: 0; width: 100%; height: 100%; object-fit: cover }
canvas { touch-action: pan-y; outline-offset: -3px }
canvas:focus-visible { outline: 3px solid var(--gsgen-accent, #6cf) }
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

const TREE = `
<canvas part="canvas" role="img" width="1" height="1"></canvas>
<img part="poster" alt="" hidden>
<div part="bar" role="progressbar" aria-label="Loading" aria-valuemin="0" aria-valuemax="100" hidden></div>
<div part="player" hidden>
  <button part="play" type="button" aria-label="Play">▶</button>
  <input part="time" type="range" min="0" max="1000" step="5" value="0" aria-label="Time">
</div>
<p part="error" role="alert" hidden></p>
<div class="status" role="status"></div>
`;

const KEYS_HELP = "Arrow keys turn, plus and minus zoom, W A S D fly, Home resets.";

/** The parts of an element, and what they say. */
export class ElementView {
  constructor(root) {
    root.innerHTML = `<style>${STYLE}</style>${TREE}`;
    const part = (name) => /** @type {any} */ (root.querySelector(`[part=${name}]`));
    this.canvas = part("canvas");
    this.poster = part("poster");
    this.play = part("play");
    this.time = part("time");
    this._bar = part("bar");
    this._player = part("player");
    this._error = part("error");
    this._status = /** @type {HTMLElement} */ (root.querySelector(".status"));
  }

  describe(alt, isInteractive) {
    this.canvas.setAttribute("aria-label", alt);
    this.canvas.tabIndex = isInteractive ? 0 : -1;
    this.canvas.ariaDescription = isInteractive ? KEYS_HELP : null;
  }

  showPoster(address) {
    this.poster.hidden = !address;
    if (address) this.poster.src = address;
  }

  /** Show how much of a file has arrived; the total is 0 where nobody knows it. */
  showProgress(loaded, total) {
    const percent = total ? Math.round((100 * loaded) / total) : 50;
    this._bar.hidden = false;
    this._bar.style.width = `${percent}%`;
    if (total) this._bar.setAttribute("aria-valuenow", String(percent));
    if (!this._status.textContent) this.say("Loading");
  }

  hideProgress() {
    this._bar.hidden = true;
  }

  /** Tell screen readers a change. @param {string} text */
  say(text) {
    this._status.textContent = text;
  }

  showError(error) {
    this._error.hidden = !error;
    this._error.textContent = error ? [error.message, error.hint].filter(Boolean).join("\n") : "";
  }

  showTime(playback) {
    this._player.hidden = !playback;
    if (!playback) return;
    this._player.toggleAttribute("data-paused", playback.paused);
    this.play.textContent = playback.paused ? "▶" : "❚❚";
    this.play.setAttribute("aria-label", playback.paused ? "Play" : "Pause");
    this.time.value = String(Math.round((1000 * playback.currentTime) / playback.duration));
    this.time.setAttribute("aria-valuetext", `${playback.currentTime.toFixed(1)} seconds`);
  }
}
