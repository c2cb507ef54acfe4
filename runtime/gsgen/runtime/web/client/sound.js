/** The sound of a scene: a recording that follows the clock of its timeline, with captions. */

import { LONGEST_STEP } from "./playback.js";

const [MOST_DRIFT, ROUNDING] = [0.2, 0.001]; // seconds between the clock and what is heard, or shown at rest
const RATES = [0.0625, 16]; // that every browser plays

/** Return the address of bytes, of which a page plays any moment, also if a server sends whole files alone. */
const urlOf = (bytes, type = "") => URL.createObjectURL(new Blob([bytes], { type }));

/** A recording at its place on a timeline, silent until a visitor's first gesture, as browsers demand. */
export class Sound {
  /**
   * @param {ShadowRoot} root Where captions are shown.
   * @param {import("./playback.js").Playback} clock
   * @param {number} start Of the recording, in seconds of the timeline.
   * @param {(ArrayBuffer | null)[]} files The recording, and captions in WebVTT.
   */
  constructor(root, clock, start, [recording, captions]) {
    this._clock = clock;
    this._start = start;
    this._stop = new AbortController();
    const { signal } = this._stop;
    const media = (this._media = document.createElement("video")); // unlike an audio element, it shows captions
    media.setAttribute("part", "captions");
    media.muted = !navigator.userActivation?.hasBeenActive;
    for (const gesture of ["pointerup", "keydown"]) document.addEventListener(gesture, () => (media.muted = false), { signal });
    if (captions) media.append(Object.assign(document.createElement("track"), { src: urlOf(captions, "text/vtt"), default: true }));
    media.addEventListener("loadedmetadata", () => this.follow(), { signal });
    /** Rejected if the browser cannot play the recording. @type {Promise<never>} */
    this.failed = new Promise((_, reject) => media.addEventListener("error", () => reject(new Error(`cannot be played: ${media.error?.message}`)), { signal }));
    media.src = urlOf(recording);
    root.append(media);
  }

  /** Follow the clock, in each frame; without frames, as in hidden pages, the sound pauses. */
  follow() {
    const [{ currentTime, paused, rate }, media] = [this._clock, this._media];
    clearTimeout(this._pause);
    if (!media.readyState) return; // not yet
    const time = currentTime - this._start;
    const place = Math.min(Math.max(time, 0), media.duration);
    const isHeard = !paused && place === time && rate >= RATES[0] && rate <= RATES[1];
    if (Math.abs(media.currentTime - place) > (isHeard ? MOST_DRIFT : ROUNDING)) media.currentTime = place;
    if (!isHeard) return media.pause();
    media.playbackRate = rate;
    this._pause = setTimeout(() => media.pause(), 1000 * LONGEST_STEP);
    if (media.paused) media.play().catch(() => {}); // the next frame tries again
  }

  destroy() {
    this._stop.abort();
    for (const { src } of [this._media, ...this._media.querySelectorAll("track")]) URL.revokeObjectURL(src);
    this._media.remove();
  }
}
