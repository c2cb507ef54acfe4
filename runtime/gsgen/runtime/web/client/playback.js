/** The time of a model: plays, pauses, loops, at any rate. */

const LONGEST_STEP = 1; // seconds between two frames; more have passed where the page was hidden

/** A clock over the range of a model's time input. */
export class Playback {
  constructor({ low, high, seconds, loop }) {
    this.low = low;
    this.high = high;
    this.duration = seconds;
    this.loop = loop;
    this.loopsByItself = loop;
    this.paused = true;
    this.rate = 1;
    this._time = 0;
    this._last = 0;
  }

  /** Seconds since the start, within the duration. */
  get currentTime() {
    return this._time;
  }

  set currentTime(seconds) {
    this._time = Math.min(Math.max(seconds, 0), this.duration);
  }

  /** The value of the time input. */
  get value() {
    return this.low + (this.high - this.low) * (this.currentTime / this.duration);
  }

  set value(value) {
    this.currentTime = ((value - this.low) / (this.high - this.low || 1)) * this.duration;
  }

  /** Whether it plays towards an end that it has reached. */
  get ended() {
    return !this.loop && this._time === (this.rate < 0 ? 0 : this.duration);
  }

  play() {
    if (this.ended) this._time = this.rate < 0 ? this.duration : 0;
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
    const seconds = this._last ? Math.min((now - this._last) / 1000, LONGEST_STEP) : 0;
    this._last = now;
    const time = this._time + seconds * this.rate;
    const { duration } = this;
    if (this.loop) this._time = ((time % duration) + duration) % duration;
    else this.currentTime = time;
    this.paused = this.ended;
    return true;
  }
}
