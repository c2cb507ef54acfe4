/** The time of a model: plays, pauses, loops. */

/** A clock over the range of a model's time input. */
export class Playback {
  constructor({ low, high, seconds, loop }) {
    this.low = low;
    this.high = high;
    this.duration = seconds;
    this.loop = loop;
    this.paused = true;
    this.rate = 1;
    this.currentTime = 0; // seconds
    this._last = 0;
  }

  /** The value of the time input. */
  get value() {
    return this.low + (this.high - this.low) * (this.currentTime / this.duration);
  }

  set value(value) {
    this.currentTime = ((value - this.low) / (this.high - this.low || 1)) * this.duration;
  }

  play() {
    if (this.currentTime >= this.duration) this.currentTime = 0;
    this.paused = false;
    this._last = 0;
  }

  pause() {
    this.paused = true;
  }

  /**
   * Move on to a moment of the page's clock; return whether the time changed.
   * @param {number} now Milliseconds.
   */
  advance(now) {
    if (this.paused) return false;
    const seconds = this._last ? Math.min((now - this._last) / 1000, 1) * this.rate : 0;
    this._last = now;
    this.currentTime += seconds;
    if (this.currentTime < this.duration) return true;
    this.paused = !this.loop;
    this.currentTime = this.loop ? this.currentTime % this.duration : this.duration;
    return true;
  }
}
