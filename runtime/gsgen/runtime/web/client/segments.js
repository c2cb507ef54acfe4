/** Segments: files that follow each other in time, of which a page has the present one and the next. */

import { GsgenError } from "./errors.js";
import { remembered } from "./once.js";
import { valueOfTime } from "./playback.js";

/** Models of which each is shown for its seconds, as one. */
export class SegmentedModel {
  /**
   * @param {{segments: {path: string, seconds: number, where: string}[], capacity: number}} part Of a scene file.
   * @param {(segment: any, signal?: AbortSignal) => Promise<import("./model.js").Model>} openModel The first has no signal.
   */
  static async open(part, openModel) {
    const model = new SegmentedModel(part, openModel);
    model._shown = await model._open(0, null);
    const { extent, up, findings } = model._shown;
    return Object.assign(model, { extent, up, findings });
  }

  constructor({ segments, capacity }, openModel) {
    this._segments = segments;
    this._capacity = capacity;
    this._openModel = openModel;
    /** @type {Map<number, Promise<import("./model.js").Model>>} */
    this._opened = new Map();
    this._lost = -1; // the next segment, if it could not be had before its time
    this._stop = new AbortController();
    const seconds = segments.reduce((sum, segment) => sum + segment.seconds, 0);
    this.time = { name: "time", low: 0, high: seconds, seconds, loop: false };
    this.inputs = [{ name: "time", role: "time", shape: [1], range: [0, seconds] }];
  }

  get sets() {
    return this._shown.sets;
  }

  get buffers() {
    return this._shown.buffers;
  }

  get followsCamera() {
    return this._shown.followsCamera;
  }

  _open(index, signal = /** @type {AbortSignal | null} */ (this._stop.signal)) {
    return remembered(this._opened, index, () => {
      const opening = this._openModel(this._segments[index], signal ?? undefined);
      opening.catch(() => this._opened.get(index) === opening && this._opened.delete(index)); // the next frame tries again
      return opening;
    });
  }

  /** Show a moment; return whether the pages are others than before. */
  async update({ time = 0 }, camera, path = null) {
    const { length } = this._segments;
    let [index, start] = [0, 0];
    while (index < length - 1 && time >= start + this._segments[index].seconds) start += this._segments[index++].seconds;
    const next = (index + 1) % length;
    const [model, before] = [await this._open(index), this._shown];
    const share = Math.min((time - start) / this._segments[index].seconds, 1);
    const isChanged = await model.update(model.time ? { [model.time.name]: valueOfTime(model.time, share) } : {}, camera, path);
    if (model.buffers.count > this._capacity) throw new GsgenError(`has ${model.buffers.count} Gaussians, expected at most ${this._capacity}`, { where: this._segments[index].path, hint: "Raise the capacity." });
    this._shown = model;
    if (next !== this._lost) this._open(next).then(() => (this._lost = -1), () => (this._lost = next));
    this._leave((other) => other !== index && other !== next);
    for (const opening of this._opened.values()) opening.then((other) => other === this._shown || other.hide?.(), () => {});
    return isChanged || model !== before;
  }

  hide() {
    this._shown.hide?.();
  }

  _leave(isLeft) {
    for (const [index, opening] of [...this._opened].filter(([other]) => isLeft(other))) {
      this._opened.delete(index);
      opening.then((model) => model.destroy(), () => {});
    }
  }

  destroy() {
    this._stop.abort();
    this._leave(() => true);
  }
}
