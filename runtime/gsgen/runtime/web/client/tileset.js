/**
 * 3D Tiles of splats: draws the tiles that a camera needs, and loads what it lacks.
 *
 * Tiles take slots of GPU memory: sets of one size, so that arrivals change no frame plan.
 */

import { eyeOf } from "./camera.js";
import { download, parsedJson } from "./download.js";
import { failing } from "./errors.js";
import { readParts } from "./file_reader.js";
import { firstSubtree, subtreeRoot } from "./implicit_tiles.js";
import {
  IDENTITY, composed, dot, linearPart, moved, normalized, plus, times, transposed, transposed4,
} from "./matrices.js";
import { OrbitCamera } from "./orbit_camera.js";
import { SplatBuffers, degreeOf, paddedRows } from "./splat_buffers.js";
import { CameraPredictor, RequestPlanner, finerOrder, requestOrder } from "./tile_planner.js";

const REBUILD = "Pages read tilesets with boxes or spheres: gsgen tiles build";
const MOST_ATTEMPTS = 4; // of a request that fails by a fault of the network or the server
const FIRST_PAUSE = 500; // milliseconds until the second attempt; doubled after each
const MOST_SPLATS = 1 << 18; // in GPU memory
const MOST_DEGREE = 3;
const GLOBE = [6.25e6, 6.48e6]; // metres from the centre of the globe: up is away from it
// Readers turn glTF content as files (x, y, z) → (−x, −y, z); of a tile, its (x, −z, y) is meant.
const TILE_FROM_FILE = [-1, 0, 0, 0, 0, 0, -1, 0, 0, -1, 0, 0, 0, 0, 0, 1];

let count = 0; // of the tiles of this page

/** A tile, in the frame of the tileset. */
class Tile {
  /** @param {string} base Address of the file that describes the tile, for its contents and messages. */
  constructor(json, parent, base) {
    this.frame = composed(parent?.frame ?? IDENTITY, transposed4(json.transform ?? IDENTITY));
    const { box, sphere } = json.boundingVolume;
    if (!box && (!sphere || json.implicitTiling)) failing(base, REBUILD)("has a volume that is not a box");
    const [x, y, z, r] = sphere ?? [];
    const numbers = box ?? [x, y, z, r, 0, 0, 0, r, 0, 0, 0, r];
    const linear = linearPart(this.frame);
    const scales = [0, 3, 6].map((first) => Math.hypot(...transposed(linear).slice(first, first + 3)));
    this.center = moved(this.frame, numbers.slice(0, 3));
    this.axes = [3, 6, 9].map((first) => times(linear, numbers.slice(first, first + 3)));
    this.error = json.geometricError * Math.max(...scales);
    this.level = parent ? parent.level + 1 : 0;
    this.adds = (json.refine ?? (parent?.adds ? "ADD" : "REPLACE")) === "ADD";
    this.schema = json.schema ?? parent?.schema;
    this.facts = json.facts ?? parent?.facts; // what the tileset says of all its tiles
    /** @type {any} Which file describes the tiles at and below this one; null of explicit tiles. */
    this.subtree = json.subtree ?? firstSubtree(json);
    const contents = this.subtree ? [this.subtree] : (json.contents ?? [json.content ?? []]);
    this.uris = contents.flatMap(({ uri = [] }) => uri);
    this.children = (json.children ?? []).map((child) => new Tile(child, this, base));
    this.base = base;
    /** @type {any[] | null} What holds its splats, once they are loaded. */
    this.slots = null;
    this.index = count++;
    this.seen = 0; // the last frame whose camera met it, or in which it came
    this.quality = -1; // of the file in its slots: 0 is the finest
    this.failures = 0;
    this.retryAt = 0; // seconds: it is not asked for before
    const { splats = 1, bytes = [], files = [], worth = [] } = json.metadata?.properties ?? {};
    const isTold = files.length > 1 && [bytes, worth].every(({ length }) => length === files.length);
    const told = files.map((uri, i) => ({ uri, bytes: bytes[i], worth: worth[i] }));
    this.files = isTold ? told.slice(this.facts.quality ?? 0) : []; // the finest first
    this.bytes = this.files.at(-1)?.bytes ?? bytes[0] ?? 0; // of the file that comes first
    this.needed = this.uris.length && Math.ceil(splats / this.facts.slotRows); // slots, as far as known
  }

  /** Return whether no side of the view has the whole box behind it. */
  meets({ view, fx, fy, cx, cy, width, height }) {
    const sides = [[fx, 0, cx], [-fx, 0, width - cx], [0, fy, cy], [0, -fy, height - cy], [0, 0, 1]];
    const center = moved(view, this.center);
    const axes = this.axes.map((axis) => times(linearPart(view), axis));
    const reach = (side, axis) => Math.abs(dot(side, axis));
    return sides.every((side) => {
      return axes.reduce((sum, axis) => sum + reach(side, axis), dot(side, center)) >= 0;
    });
  }

  /** Return the geometric error in pixels; infinite within the box. */
  pixels(camera) {
    const offset = plus(eyeOf(camera), -1, this.center);
    const beyond = this.axes.map((axis) => {
      const length = Math.hypot(...axis) || Number.MIN_VALUE;
      return Math.max(Math.abs(dot(axis, offset)) / length - length, 0);
    });
    return this.error && (this.error * camera.fy) / Math.hypot(...beyond);
  }
}

const slotsOf = (tiles) => tiles.reduce((sum, { needed }) => sum + needed, 0);

/** Return the root tile of a tileset. */
function rootOf({ root, schema, metadata }, parent, address, slotRows = parent?.facts.slotRows) {
  return new Tile({ ...root, schema, facts: { ...metadata?.properties, slotRows } }, parent, address);
}

/** Return the result of a task, which is tried again after faults that may pass. */
function persistently(task, signal, attempt = 1) {
  return task().catch(async (error) => {
    if (!error.isTransient || attempt === MOST_ATTEMPTS) throw error;
    await new Promise((resolve) => setTimeout(resolve, FIRST_PAUSE * 2 ** (attempt - 1)));
    signal.throwIfAborted();
    return persistently(task, signal, attempt + 1);
  });
}

/** A tileset in a page. */
export class TilesetModel {
  /** Open a tileset, and wait for its coarsest tiles; see the constructor. */
  static async open(kernels, tileset, name, options) {
    const model = new TilesetModel(kernels, tileset, name, options);
    const camera = new OrbitCamera(model.extent, model.up).camera(64, 64);
    await model.update({}, camera);
    while (model.loading && !model._held.size && !options.signal?.aborted) {
      await Promise.race([...model._planner.pending.values()].map(({ end }) => end));
      await model.update({}, camera);
    }
    if (options.signal?.aborted) model.destroy();
    options.signal?.throwIfAborted();
    return model;
  }

  /**
   * @param {import("./host.js").KernelCache} kernels
   * @param {any} tileset The parsed tileset.json.
   * @param {import("./model.js").Options} options
   */
  constructor({ device, plans }, tileset, name, options) {
    const { slotRows, maxError } = plans.streaming;
    const channels = 3 * (1 + (tileset.metadata?.properties?.sh_degree ?? MOST_DEGREE)) ** 2;
    const facts = { count: slotRows, channels, space: /** @type {const} */ ("sh") };
    const length = Math.floor((options.maxSplats ?? MOST_SPLATS) / slotRows);
    /** @type {any[]} All slots; those that the last camera does not need have no live row. */
    this.sets = Array.from({ length }, () => {
      return { buffers: new SplatBuffers(device, plans, facts), transform: IDENTITY, live: 0 };
    });
    this._free = [...this.sets];
    this._rules = plans.streaming;
    this._predictor = new CameraPredictor(plans.streaming);
    this._planner = new RequestPlanner(plans.streaming, (tile, flight) => {
      flight.end = this._load(tile, flight).finally(() => this._stop.signal.aborted || this._options.onChange());
    });
    this._planned = -Infinity; // when tiles to come were last predicted
    this._ahead = /** @type {Tile[]} */ ([]);
    this._options = { ...options, maxError: options.maxError ?? maxError };
    this._root = rootOf(tileset, null, String(new URL(options.source ?? name, document.baseURI)), slotRows);
    /** From the axes of the splats that it was built from, which scene files place, to its own. */
    this.frame = this._root.frame;
    const { center, axes } = this._root;
    this.extent = { center, reach: Math.hypot(...axes.flat()) || 1 };
    // Where the scene is 0, 0, 0: map coordinates are no place on the globe.
    const offset = times(linearPart(this._root.frame), tileset.metadata?.properties?.origin ?? [0, 0, 0]);
    const place = center.map((number, i) => number - offset[i]);
    const distance = Math.hypot(...place);
    this.up = distance > GLOBE[0] && distance < GLOBE[1] ? normalized(place) : [0, 0, 1];
    this.followsCamera = true;
    this.time = null;
    this.inputs = [];
    this.buffers = { count: 0, isLinear: false };
    /** @type {Tile[]} */
    this.drawn = [];
    this._held = new Set();
    this._frame = 0;
    this._stop = new AbortController();
  }

  /** Choose the tiles of a camera, and request what lacks. */
  async update(_, camera) {
    this._frame += 1;
    const time = performance.now() / 1000;
    const cut = this._cut(camera);
    for (const tile of cut.seen.keys()) tile.seen = this._frame;
    this.drawn = this._drawn(this._root, cut) ?? [];
    for (const { buffers } of this.sets) buffers.count = 0;
    for (const { buffers, live } of this.drawn.flatMap(({ slots }) => slots)) buffers.count = live;
    this._predictor.observe(time, camera);
    const isLoaded = (tile) => tile.slots || !tile.uris.length || tile.retryAt > time;
    this._planner.frame(time, cut.seen, isLoaded);
    const finer = finerOrder(this.drawn.filter((tile) => tile.retryAt <= time), eyeOf(camera));
    // What would not fit beside the tiles in flight is asked for later.
    this._planner.fill((tile) => isLoaded(tile) || tile.needed > this._room(), finer, () => this._predicted(time, camera));
    return false;
  }

  /** Return the tiles that a camera sees with their errors, and those that are refined: the worst, as far as slots suffice. */
  _cut(camera) {
    const [seen, refined] = [new Map(), new Set()];
    const see = (tiles) => tiles.forEach((tile) => seen.set(tile, tile.pixels(camera)));
    const met = (tiles) => tiles.filter((tile) => tile.meets(camera));
    see(met([this._root]));
    for (const open = new Set(seen.keys()); open.size; ) {
      const worst = [...open].reduce((first, other) => (seen.get(other) > seen.get(first) ? other : first));
      open.delete(worst);
      const below = met(worst.children);
      const fits = slotsOf([...seen.keys(), ...below]) <= this.sets.length;
      if (seen.get(worst) <= this._options.maxError || !worst.children.length || !fits) continue;
      refined.add(worst);
      see(below);
      below.forEach((tile) => open.add(tile));
    }
    return { seen, refined };
  }

  /** Return the tiles to draw at and below a tile; null while one of them is not loaded. */
  _drawn(tile, cut) {
    if (!cut.seen.has(tile)) return [];
    const own = tile.slots ? [tile] : tile.uris.length ? null : [];
    if (!cut.refined.has(tile)) return own;
    const below = tile.children.map((child) => this._drawn(child, cut));
    const loaded = below.flatMap((tiles) => tiles ?? []);
    if (tile.adds) return own && [...own, ...loaded];
    return below.every(Boolean) || !tile.uris.length ? loaded : own;
  }

  /** Return the tiles that predicted cameras see, the earliest first. */
  _predicted(time, camera) {
    const { horizonSeconds, horizonFractions, planSeconds } = this._rules;
    if (time - this._planned < planSeconds) return this._ahead;
    const views = horizonFractions.map((share) => this._predictor.predict(share * horizonSeconds));
    const cuts = views.filter(Boolean).map((view) => this._cut({ ...camera, view }));
    [this._planned, this._ahead] = [time, [...new Set(cuts.flatMap(({ seen }) => requestOrder(seen)))]];
    return this._ahead;
  }

  /** How many tiles are being loaded. */
  get loading() {
    return this._planner.pending.size;
  }

  async _load(tile, flight) {
    const signal = AbortSignal.any([this._stop.signal, flight.stop.signal]);
    const quality = tile.quality < 0 ? Math.max(tile.files.length - 1, 0) : 0;
    try {
      const read = async (uri) => {
        const address = String(new URL(uri, tile.base));
        const { subtree, schema, base } = tile;
        const onProgress = (loaded) => (flight.loaded = loaded);
        if (subtree) {
          const data = await download(address, onProgress, signal);
          return new Tile(subtreeRoot(data, subtree, schema, address, tile.facts?.files), tile, base);
        }
        const { kind, bytes, parts } = await readParts({ name: address, address }, onProgress, signal);
        if (kind === "onnx") failing(address)("is a generator, expected splats or a tileset");
        return bytes ? rootOf(parsedJson(bytes), tile, address) : parts;
      };
      const uris = tile.files.length ? [tile.files[quality].uri] : tile.uris;
      const loaded = (await Promise.all(uris.map((uri) => persistently(() => read(uri), signal)))).flat();
      if (signal.aborted) return;
      const roots = loaded.filter((part) => part instanceof Tile);
      tile.children.push(...roots);
      if (roots.length) [tile.uris, tile.needed, tile.error] = [[], 0, Infinity]; // other tiles take its place
      this._place(tile, loaded.filter((part) => !(part instanceof Tile)), quality);
      this._planner.arrive(tile, performance.now() / 1000, tile.files[quality]?.bytes ?? flight.loaded);
    } catch (error) {
      if (signal.aborted) return;
      this._planner.pending.delete(tile);
      const pause = error.isTransient ? this._rules.retrySeconds * 2 ** tile.failures : Infinity;
      tile.retryAt = performance.now() / 1000 + pause;
      if (pause < Infinity) setTimeout(() => signal.aborted || this._options.onChange(), 1000 * pause);
      if (tile.failures++ === 0) this._options.onError(error);
    }
  }

  /** Copy splats into slots; if tiles that the camera needs hold them all, later. */
  _place(tile, splats, quality) {
    const rows = this._rules.slotRows;
    const parts = splats.flatMap((set) => {
      return Array.from({ length: Math.ceil(set.count / rows) }, (_, i) => [set, i * rows]);
    });
    tile.needed = parts.length;
    if (tile.slots?.length !== parts.length) this._release(tile);
    if (!tile.slots && this._room(tile) < parts.length) return;
    while (!tile.slots && this._free.length < parts.length) {
      this._release([...this._held].reduce((first, other) => (other.seen < first.seen ? other : first)));
    }
    const slots = tile.slots ?? this._free.splice(-parts.length, parts.length);
    tile.slots = parts.map(([set, first], i) => {
      const { channels, antialias } = set;
      const live = Math.min(rows, set.count - first);
      const part = (numbers, width) => numbers.subarray(first * width, (first + live) * width);
      slots[i].buffers.write(0, part(set.rows, 10), paddedRows(part(set.appearance, channels), channels, slots[i].buffers.stride));
      const transform = composed(tile.frame, composed(TILE_FROM_FILE, set.transform));
      return Object.assign(slots[i], { transform, live, antialias, degree: degreeOf(channels, "sh") });
    });
    [tile.quality, tile.seen] = [quality, this._frame];
    this._held.add(tile);
  }

  /** Return how many slots a tile may take beside those that the camera needs or that are on their way. */
  _room(tile = undefined) {
    const unseen = [...this._held].filter(({ seen }) => seen < this._frame);
    const coming = [...this._planner.pending.keys()].filter((other) => other !== tile && !other.slots);
    return this._free.length + slotsOf(unseen) - slotsOf(coming);
  }

  /** Free the slots of a tile. */
  _release(tile) {
    this._free.push(...(tile.slots ?? []));
    this._held.delete(tile);
    [tile.slots, tile.quality] = [null, -1];
  }

  destroy() {
    this._stop.abort();
    for (const { buffers } of this.sets) buffers.destroy();
  }
}
