/** The shadow tree of the element: canvas, poster, progress, player, and texts. */

import { MARKUP } from "./element_markup.js";

const KEYS_HELP = "Arrow keys turn, plus and minus zoom, W A S D fly, Home resets.";

/** The parts of an element, and what they say. */
export class ElementView {
  constructor(root) {
    root.innerHTML = MARKUP;
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
