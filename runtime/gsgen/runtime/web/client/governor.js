/** Chooses how many pixels frames have while they change, by the time that they take. */

const SCALES = [1, 0.75, 0.5]; // of width and height
const SLOW = 33; // milliseconds of a frame above which the next ones are smaller …
const FAST = 20; // … and below which they are larger, if those would take no longer
const FRAMES = 4; // that are measured before a change
const HELPS = 0.9; // of the time: a smaller size that takes longer than this is of no use

export class Governor {
  constructor() {
    this._level = 0;
    this._isFutile = false;
    this._restart(null);
  }

  /** The factor of width and height. */
  get scale() {
    return SCALES[this._level];
  }

  /** Tell how long a frame of the present size took. */
  measured(milliseconds) {
    this._times.push(milliseconds);
    if (this._times.length < FRAMES) return;
    const time = this._times.sort((a, b) => a - b)[FRAMES / 2 - 1]; // one slow frame is no reason
    const larger = time * (SCALES[this._level - 1] / this.scale) ** 2;
    if (this._before && time > HELPS * this._before) {
      this._isFutile = true;
      this._restart(null, -1);
    } else if (time > SLOW && this._level < SCALES.length - 1 && !this._isFutile) this._restart(time, 1);
    else this._restart(null, larger < FAST ? -1 : 0);
  }

  /** Measure another size. @param {number | null} before The time of the larger size before this one. */
  _restart(before, step = 0) {
    this._level += step;
    this._before = before;
    /** @type {number[]} */
    this._times = [];
  }
}
