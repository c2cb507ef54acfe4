/** The time of a model: plays, pauses, loops, at any rate. */

export const LONGEST_STEP = 1; // seconds between two frames; more have passed where the page was hidden

/** Return what a time input goes through: of whole numbers, each lasts as long as the others. */
function spanOf({ low, high, isWhole = false }) {
  return high - low + (isWhole ? 1 : 0);
}

/** Return the value of a time input at a share of its duration, from 0 to 1. */
export function valueOfTime(time, share) {
  const value = time.low + spanOf(time) * share;
  return time.isWhole ? Math.min(Math.floor(value), time.high) : value;
}

/** A clock over the range of a model's time input. */
export class Playback {
  constructor({ low, high, seconds, loop, isWhole = false }) {
    this.low = low;
    this.high = high;
    this.isWhole = isWhole;
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
    return valueOfTime(this, this.currentTime / this.duration);
  }

  set value(value) {
    this.currentTime = ((value - this.low) / (spanOf(this) || 1)) * this.duration;
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
    this._time = this.timeIn(seconds);
    this.paused = this.ended;
    return true;
  }

  /** Return the time in some seconds of the page's clock. */
  timeIn(seconds) {
    const { duration, loop } = this;
    const time = this._time + seconds * this.rate;
    return loop ? ((time % duration) + duration) % duration : Math.min(Math.max(time, 0), duration);
  }
}
