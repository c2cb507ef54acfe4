/** The order in which tiles are requested: decision by decision that of `gsgen.tiles.streaming.planner`. */

import { eyeOf, viewOf } from "./camera.js";
import { linearPart, plus, product, rotation, transposed } from "./matrices.js";

const PRIOR_TILES = 4; // prefetched tiles, half of them seen, that precision begins with

/** Return tiles in the order of request. @param {Map<any, number>} errors Of each tile, in pixels. */
export function requestOrder(errors) {
  // The difference of two infinite errors is no number: then the index decides.
  return [...errors.keys()].sort((a, b) => a.level - b.level || errors.get(b) - errors.get(a) || a.index - b.index);
}

/** Return drawn tiles that have a finer file, by worth × area gained per byte of it. */
export function finerOrder(tiles, eye) {
  const gain = ({ center, axes, files: [{ worth, bytes }], files, quality }) => {
    const share = Math.min(Math.hypot(...axes.flat()) / Math.max(Math.hypot(...plus(center, -1, eye)), 1e-9), 1);
    return (share ** 2 * (worth - files[quality].worth)) / bytes;
  };
  return tiles.filter(({ quality }) => quality > 0).sort((a, b) => gain(b) - gain(a) || a.index - b.index);
}

/** Predicts cameras: positions keep their velocity, turns fade. */
export class CameraPredictor {
  constructor(rules) {
    this._rules = rules;
    /** @type {{time: number, eye: number[], turn: number[]}[]} Turns are camera → world. */
    this._poses = [];
  }

  observe(time, camera) {
    const poses = this._poses;
    poses.push({ time, eye: eyeOf(camera), turn: transposed(linearPart(camera.view)) });
    while (poses.length > 2 && poses[1].time < time - this._rules.velocitySeconds) poses.shift();
  }

  /** Return the view, world → camera, some seconds after the last one; null after too few. */
  predict(seconds) {
    const [first, last] = [this._poses[0], this._poses.at(-1)];
    if (!first || last.time <= first.time) return null;
    const share = 1 / (last.time - first.time);
    const eye = plus(last.eye, seconds * share, plus(last.eye, -1, first.eye));
    const relative = product(last.turn, transposed(first.turn));
    const axis = [relative[7] - relative[5], relative[2] - relative[6], relative[3] - relative[1]];
    const sine = Math.hypot(...axis); // twice the sine; the trace is 1 + 2 cos
    const angle = Math.atan2(sine, relative[0] + relative[4] + relative[8] - 1);
    const { turnSeconds } = this._rules;
    const turned = angle * share * turnSeconds * (1 - Math.exp(-seconds / turnSeconds));
    const turn = rotation(axis.map((x) => x / (sine || 1)), turned);
    return viewOf(transposed(product(turn, last.turn)), eye);
  }
}

/** Decides what is requested, and what is cancelled. */
export class RequestPlanner {
  /** @param {(tile: any, flight: any) => any} request Fetches a tile. */
  constructor(rules, request) {
    this._rules = rules;
    this._request = request;
    this._order = /** @type {any[]} */ ([]);
    this.pending = new Map(); // the tiles in flight, why (needed, prefetched or finer), and how far
    this._early = new Map(); // prefetched tiles that were not seen yet, and when they came
    this._unseen = new Map(); // tiles that came and were not seen, and the bytes of their files
    this._used = this._late = 0;
    this.received = this.wasted = 0; // bytes
  }

  /** Take the tiles that a camera sees with their errors; cancel what delays them. */
  frame(time, seen, isLoaded) {
    this._order = requestOrder(seen);
    for (const tile of seen.keys()) if (isLoaded(tile)) this._unseen.delete(tile);
    for (const [tile, arrival] of this._early) {
      const isSeen = seen.has(tile) && Boolean(isLoaded(tile));
      if (!isSeen && time - arrival <= 2 * this._rules.horizonSeconds) continue;
      this._used += Number(isSeen);
      this._late += Number(!isSeen);
      this._early.delete(tile);
    }
    for (const [tile, flight] of this.pending) {
      if (flight.purpose === "prefetched" && seen.has(tile)) flight.purpose = "needed";
    }
    if (!this.missing(isLoaded).length) return;
    for (const [tile, { purpose, loaded }] of this.pending) {
      const { bytes } = purpose === "finer" ? tile.files[0] : tile;
      if (purpose !== "needed" && loaded < this._rules.cancelFraction * bytes) this.cancel(tile);
    }
  }

  /** End a request; what has come of it is wasted. */
  cancel(tile) {
    const { loaded, stop } = this.pending.get(tile);
    this.pending.delete(tile);
    stop.abort();
    [this.received, this.wasted] = [this.received + loaded, this.wasted + loaded];
  }

  /**
   * Request while connections are free.
   * @param {any[]} candidates Tiles that will be seen, the most urgent first.
   * @param {boolean} [isKnown] Whether that is certain: nothing is wasted along a path that is known.
   */
  fill(isLoaded, finer, candidates, isKnown = false) {
    const open = () => [...this.pending.values()].filter(({ isRead }) => !isRead).length;
    while (open() < this._rules.requests) {
      const [tile, purpose] = this._next(isLoaded, finer, candidates, isKnown);
      if (!tile) return;
      const flight = { purpose, loaded: 0, isRead: false, stop: new AbortController(), end: null };
      this.pending.set(tile, flight);
      flight.end = this._request(tile, flight);
    }
  }

  /** Take note of a tile that has come, with the bytes of its file. */
  arrive(tile, time, bytes) {
    if (this.pending.get(tile)?.purpose === "prefetched") this._early.set(tile, time);
    this.pending.delete(tile);
    this.received += bytes;
    this.wasted += this._unseen.get(tile) ?? 0; // dropped unseen, and asked for again
    this._unseen.set(tile, bytes);
  }

  /** Return the seen tiles that are neither loaded nor in flight; a missing root alone. */
  missing(isLoaded) {
    const missing = this._order.filter((tile) => !isLoaded(tile));
    return (missing[0]?.level === 0 ? missing.slice(0, 1) : missing).filter((tile) => !this.pending.has(tile));
  }

  _next(isLoaded, finer, candidates, isKnown) {
    const [first] = this.missing(isLoaded);
    if (first) return [first, "needed"];
    if (!this._order.every(isLoaded)) return [];
    const ahead = candidates.find((tile) => !isLoaded(tile) && !this.pending.has(tile));
    if (ahead && (isKnown || this._affords(ahead.bytes))) return [ahead, "prefetched"];
    return [finer.find((tile) => !this.pending.has(tile)), "finer"];
  }

  /** Return whether one more prefetch keeps the expected share of unused bytes low. */
  _affords(bytes) {
    const sum = (numbers) => numbers.reduce((total, number) => total + number, 0);
    const asked = bytes + sum([...this.pending].map(([tile, { purpose }]) => (purpose === "prefetched" ? tile.bytes : 0)));
    const received = this.received + asked;
    const unseen = this.wasted + sum([...this._unseen.values()]) + asked;
    const precision = (this._used + PRIOR_TILES / 2) / (this._used + this._late + PRIOR_TILES);
    const hoped = (asked + sum([...this._early.keys()].map((tile) => tile.bytes))) * precision;
    const { wasteFraction, unseenFraction } = this._rules;
    return unseen - hoped <= wasteFraction * received && unseen <= unseenFraction * received;
  }
}
