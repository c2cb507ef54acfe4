/** The shadow tree of the element: canvas, poster, progress, player, and texts. */

import { elementStyle } from "./element_style.js";

const KEYS_HELP = "Arrow keys turn, plus and minus zoom, W A S D fly, Home resets.";

/** Return an element that is a named part of the shadow tree, with attributes and children. */
function part(tag, name, attributes = {}, ...children) {
  const element = document.createElement(tag);
  element.setAttribute("part", name);
  for (const [attribute, value] of Object.entries(attributes)) element.setAttribute(attribute, value);
  element.append(...children);
  return /** @type {any} */ (element);
}

/** The parts of an element, and what they say. */
export class ElementView {
  /** @param {ShadowRoot} root */
  constructor(root) {
    this.root = root;
    this.adopt();
    this.canvas = part("canvas", "canvas", { role: "img", width: "1", height: "1" });
    this.poster = part("img", "poster", { alt: "", hidden: "" });
    this.annotations = part("div", "annotations", { hidden: "" });
    const progress = { role: "progressbar", "aria-label": "Loading", "aria-valuemin": "0", "aria-valuemax": "100" };
    this._bar = part("div", "bar", { ...progress, hidden: "" });
    this.play = part("button", "play", { type: "button", "aria-label": "Play" }, "▶");
    const range = { type: "range", min: "0", max: "1000", step: "5", value: "0" };
    this.time = part("input", "time", { ...range, "aria-label": "Time" });
    this._player = part("div", "player", { hidden: "" }, this.play, this.time);
    this._error = part("p", "error", { role: "alert", hidden: "" });
    this._status = part("div", "status", { class: "status", role: "status" });
    /** Where colours of CSS are computed. */
    this.probe = part("span", "probe", { hidden: "" });
    const parts = [this.canvas, this.poster, this.annotations, this._bar, this._player, this._error];
    root.append(...parts, this._status, this.probe);
  }

  /** Take the style of the document that the element is in. */
  adopt() {
    this.root.adoptedStyleSheets = [elementStyle(this.root.ownerDocument)];
  }

  describe(alt, isInteractive) {
    this.canvas.setAttribute("aria-label", alt);
    this.canvas.tabIndex = isInteractive ? 0 : -1;
    this.canvas.ariaDescription = isInteractive ? KEYS_HELP : null;
  }

  showPoster(address) {
    this.poster.hidden = !address;
    if (address) this.poster.src = address;
    else this.poster.removeAttribute("src");
  }

  /** Show how much of a file has arrived; the total is 0 where nobody knows it. */
  showProgress(loaded, total) {
    const percent = total ? Math.round((100 * Math.min(loaded, total)) / total) : 50;
    this._bar.hidden = false;
    this._bar.style.width = `${percent}%`;
    if (total) this._bar.setAttribute("aria-valuenow", String(percent));
    else this._bar.removeAttribute("aria-valuenow");
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
