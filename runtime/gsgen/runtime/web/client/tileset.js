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
const PATH_SECONDS = [3, 4, 5, 6, 7, 8]; // ahead on a path that is known, beyond the horizon of predictions
const GLOBE = [6.25e6, 6.48e6]; // metres from the centre of the globe: up is away from it
// Readers turn glTF content as files (x, y, z) → (−x, −y, z); of a tile, its (x, −z, y) is meant.
const TILE_FROM_FILE = [-1, 0, 0, 0, 0, 0, -1, 0, 0, -1, 0, 0, 0, 0, 0, 1];

let count = 0; // of the tiles of this page
/** The tilesets of this page that are in view, which share one budget. @type {Set<TilesetModel>} */
const inView = new Set();
const now = () => performance.now() / 1000; // seconds

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
    this.level = json.level ?? (parent ? parent.level + 1 : 0);
    this.parent = parent;
    this.rows = json.rows; // of a file that several tiles share: the first, and how many
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

const isAbove = (tiles, tile) => Boolean(tile && (tiles.has(tile) || isAbove(tiles, tile.parent)));

/** Return whether one of some tiles is above a tile, or below it. @param {Set<Tile> | Map<Tile, any>} tiles */
function replaces(tile, tiles) {
  return isAbove(tiles, tile.parent) || [...tiles.keys()].some((other) => isAbove(new Set([tile]), other.parent));
}

/** Return whether a tile is there, or cannot be had now. */
const isSettled = (tile) => tile.slots || !tile.uris.length || tile.retryAt > now();
const slotsOf = (tiles) => tiles.reduce((sum, { needed }) => sum + needed, 0);

/** Return the JSON of a tileset. */
async function readTileset(json, address) {
  return json.tree || json.lodLevels ? (await import("./streamed_sog.js")).tilesetOf(json, address) : json;
}

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

/**
 * What has come of a tileset: numbers of tiles, and bytes of their files.
 * @typedef {{missing: number, holes: number, drawn: number, held: number, loading: number, received: number, wasted: number}} Statistics
 *     `missing` tiles are seen and are not there; in place of `holes`, nothing is drawn.
 */

/** A tileset in a page. */
export class TilesetModel {
  /** Open a tileset, and wait for its coarsest tiles; see the constructor. */
  static async open(kernels, json, name, options) {
    const address = String(new URL(options.source ?? name, document.baseURI));
    const model = new TilesetModel(kernels, await readTileset(json, address), address, options);
    const camera = new OrbitCamera(model.extent, model.up).camera(64, 64);
    while (!model._held.size && !options.signal?.aborted) {
      await model.update({}, camera);
      model._camera = null; // what it sees next, another camera says
      if (!model.loading) break;
      await Promise.race([...model._planner.pending.values()].map(({ end }) => end));
    }
    if (options.signal?.aborted) model.destroy();
    options.signal?.throwIfAborted();
    return model;
  }

  /**
   * @param {import("./host.js").KernelCache} kernels
   * @param {any} tileset The parsed tileset.json.
   * @param {string} address
   * @param {import("./model.js").Options} options
   */
  constructor({ device, plans }, tileset, address, options) {
    const { slotRows, maxError } = plans.streaming;
    const channels = 3 * (1 + (tileset.metadata?.properties?.sh_degree ?? MOST_DEGREE)) ** 2;
    const facts = { count: slotRows, channels, space: /** @type {const} */ ("sh") };
    /** @type {any[]} All slots; those that the last camera does not need have no live row. */
    this.sets = [];
    /** @type {any[]} Those of no tile. */
    this._free = [];
    this._budget = Math.floor((options.maxSplats ?? MOST_SPLATS) / slotRows);
    this._newSlot = () => ({ buffers: new SplatBuffers(device, plans, facts), transform: IDENTITY, live: 0 });
    this._rules = plans.streaming;
    this._predictor = new CameraPredictor(plans.streaming);
    this._planner = new RequestPlanner(plans.streaming, (tile, flight) => this._load(tile, flight));
    /** The camera of the last frame, and where it will be. @type {any} */
    this._camera = null;
    /** @type {((seconds: number) => any) | null} */
    this._path = null;
    this._planned = -Infinity; // when tiles to come were last predicted
    this._future = /** @type {Tile[]} */ ([]); // all of them, the earliest first
    this._ahead = /** @type {Tile[]} */ ([]); // those that slots suffice for
    this._options = { ...options, maxError: options.maxError ?? maxError };
    this._root = rootOf(tileset, null, address, slotRows);
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
    /** The cut of the last camera. */
    this._shown = { seen: new Map(), refined: new Set(), holes: 0 };
    /** The opacity of each tile on the screen. @type {Map<Tile, number>} */
    this._fades = new Map();
    this._fadedAt = 0;
    this._held = new Set();
    this._frame = 0;
    this._stop = new AbortController();
    this._resize(true);
    this._placed = this.sets; // those that the renderer has
  }

  /**
   * Choose the tiles of a camera, and request what lacks.
   * @param {((seconds: number) => any) | null} [path] The camera in some seconds, if it is known.
   */
  async update(_, camera, path = null) {
    if (this._stop.signal.aborted) return false;
    this._frame += 1;
    const time = now();
    this._resize(true);
    const cut = this._cut(camera);
    for (const tile of cut.seen.keys()) tile.seen = this._frame;
    const drawn = this._drawn(this._root, cut);
    [this.drawn, this._shown] = [drawn ?? [], cut];
    if (!drawn) cut.holes += 1;
    this._fade(time);
    for (const { buffers } of this.sets) buffers.count = 0;
    for (const [{ slots }, opacityScale] of this._fades) {
      for (const slot of slots ?? []) [slot.buffers.count, slot.opacityScale] = [slot.live, opacityScale];
    }
    [this._camera, this._path] = [camera, path];
    this._predictor.observe(time, camera);
    this._planner.frame(time, cut.seen, isSettled);
    this._expect(time);
    this._fill();
    const isChanged = this._placed !== this.sets;
    this._placed = this.sets;
    return isChanged;
  }

  /** Out of view, request nothing, and give the slots to others until the next update. */
  hide() {
    this._camera = null;
    for (const tile of this._planner.pending.keys()) this._planner.cancel(tile);
    this._resize(false);
  }

  /** Request tiles for the last camera, in each frame and whenever a connection is free. */
  _fill() {
    if (!this._camera) return;
    const finer = finerOrder(this.drawn.filter((tile) => tile.slots && tile.retryAt <= now()), eyeOf(this._camera));
    // What would not fit beside the tiles in flight is asked for later.
    const isLoaded = (tile) => isSettled(tile) || tile.needed > this._room();
    this._planner.fill(isLoaded, finer, this._ahead, Boolean(this._path));
  }

  /** Return the tiles that a camera sees with their errors, and those that are refined: the worst, as far as slots suffice. */
  _cut(camera) {
    const [seen, refined] = [new Map(), new Set()];
    const see = (tiles) => tiles.forEach((tile) => seen.set(tile, tile.pixels(camera)));
    const met = (tiles) => tiles.filter((tile) => tile.meets(camera));
    see(met([this._root]));
    let slots = slotsOf([...seen.keys()]);
    for (const open = new Set(seen.keys()); open.size; ) {
      const worst = [...open].reduce((first, other) => (seen.get(other) > seen.get(first) ? other : first));
      open.delete(worst);
      const below = met(worst.children);
      const more = slots + slotsOf(below);
      if (seen.get(worst) <= this._options.maxError || !worst.children.length || more > this.sets.length) continue;
      slots = more;
      refined.add(worst);
      see(below);
      below.forEach((tile) => open.add(tile));
    }
    return { seen, refined, holes: 0 };
  }

  /** Return the tiles to draw at and below a tile; null while one of them is not loaded. */
  _drawn(tile, cut) {
    if (!cut.seen.has(tile)) return [];
    const own = tile.slots ? [tile] : tile.uris.length ? null : [];
    if (!cut.refined.has(tile)) return own;
    const below = tile.children.map((child) => this._drawn(child, cut));
    const loaded = below.flatMap((tiles) => tiles ?? []);
    if (tile.adds) return own && [...own, ...loaded];
    if (below.every(Boolean)) return loaded;
    if (tile.uris.length) return own;
    cut.holes += below.filter((tiles) => !tiles).length;
    return loaded;
  }

  /** Fade tiles in that take the place of others, and those out; what comes into view is there at once. */
  _fade(time) {
    const { fadeSeconds, fadeStep } = this._rules;
    const [before, step] = [this._fades, Math.min(time - this._fadedAt, fadeStep) / fadeSeconds];
    const drawn = new Set(this.drawn);
    const entries = this.drawn.map((tile) => {
      const share = before.get(tile) ?? (replaces(tile, before) ? 0 : 1);
      return /** @type {[Tile, number]} */ ([tile, Math.min(share + step, 1)]);
    });
    for (const [tile, share] of before) {
      if (!drawn.has(tile) && tile.slots && share > step && replaces(tile, drawn)) entries.push([tile, share - step]);
    }
    [this._fades, this._fadedAt] = [new Map(entries), time];
    if (entries.some(([, share]) => share < 1)) this._options.onChange();
  }

  /** Find the tiles that the camera will see; those that fit beside what it sees keep their slots. */
  _expect(time) {
    const { horizonSeconds, horizonFractions, planSeconds } = this._rules;
    const { seen } = this._shown;
    if (!this._planner.missing(isSettled).length && time - this._planned >= planSeconds) {
      const ahead = horizonFractions.map((share) => share * horizonSeconds);
      const predicted = (view) => view && { ...this._camera, view };
      const cameras = this._path
        ? [...ahead, ...PATH_SECONDS].map(this._path)
        : ahead.map((seconds) => predicted(this._predictor.predict(seconds)));
      const orders = cameras.filter(Boolean).map((camera) => requestOrder(this._cut(camera).seen));
      [this._planned, this._future] = [time, [...new Set(orders.flat())]];
    }
    let slots = slotsOf([...seen.keys()]);
    this._ahead = this._future.filter((tile) => {
      if (seen.has(tile) || slots + tile.needed > this.sets.length) return false;
      slots += tile.needed;
      tile.seen = this._frame;
      return true;
    });
  }

  /** @returns {Statistics} */
  get statistics() {
    const { received, wasted } = this._planner;
    const { seen, holes } = this._shown;
    const missing = [...seen.keys()].filter((tile) => tile.uris.length && !tile.slots).length;
    return { missing, holes, drawn: this.drawn.length, held: this._held.size, loading: this.loading, received, wasted };
  }

  /** Take the own share of the slots of all tilesets in view; out of view, one slot. */
  _resize(isInView) {
    if (inView.has(this) !== isInView) {
      isInView ? inView.add(this) : inView.delete(this);
      inView.forEach((model) => model._options.onChange()); // their shares are others now
    }
    const length = isInView ? Math.max(Math.floor(this._budget / inView.size), 1) : 1;
    const before = this.sets.length;
    if (length > before) this._free.push(...Array.from({ length: length - before }, this._newSlot));
    while (this._free.length < before - length) this._release(this._oldest());
    for (const { buffers } of this._free.splice(0, before - length)) buffers.destroy();
    if (length !== before) this.sets = [...this._free, ...[...this._held].flatMap(({ slots }) => slots)];
  }

  /** Return the tile that no camera saw for the longest time; of several, the finest. */
  _oldest() {
    return [...this._held].reduce((first, other) => ((other.seen - first.seen || first.level - other.level) < 0 ? other : first));
  }

  /** How many tiles are being loaded. */
  get loading() {
    return this._planner.pending.size;
  }

  async _load(tile, flight) {
    const signal = AbortSignal.any([this._stop.signal, flight.stop.signal]);
    const quality = tile.quality < 0 ? Math.max(tile.files.length - 1, 0) : 0;
    const { uri, bytes = tile.bytes || Infinity } = tile.files[quality] ?? {};
    const uris = uri ? [uri] : tile.uris;
    try {
      const read = async (uri) => {
        const address = String(new URL(uri, tile.base));
        const { subtree, schema, base } = tile;
        const onProgress = (loaded) => {
          flight.loaded = loaded;
          if (loaded < bytes || flight.isRead) return;
          flight.isRead = true; // and is decoded, while the connection is free
          this._fill();
        };
        if (subtree) {
          const data = await download(address, onProgress, signal);
          return new Tile(subtreeRoot(data, subtree, schema, address, tile.facts?.files), tile, base);
        }
        const { kind, bytes: json, parts } = await readParts({ name: address, address, range: tile.rows }, onProgress, signal);
        if (kind === "onnx") failing(address)("is a generator, expected splats or a tileset");
        return json ? rootOf(await readTileset(parsedJson(json), address), tile, address) : parts;
      };
      const loaded = (await Promise.all(uris.map((uri) => persistently(() => read(uri), signal)))).flat();
      if (signal.aborted) return;
      const roots = loaded.filter((part) => part instanceof Tile);
      tile.children.push(...roots);
      if (roots.length) [tile.uris, tile.needed, tile.error] = [[], 0, Infinity]; // other tiles take its place
      this._place(tile, loaded.filter((part) => !(part instanceof Tile)), quality);
      this._planner.arrive(tile, now(), Number.isFinite(bytes) ? bytes : flight.loaded);
    } catch (error) {
      if (signal.aborted) return;
      this._planner.pending.delete(tile);
      const pause = error.isTransient ? this._rules.retrySeconds * 2 ** tile.failures : Infinity;
      tile.retryAt = now() + pause;
      if (pause < Infinity) setTimeout(() => signal.aborted || this._options.onChange(), 1000 * pause);
      if (tile.failures++ === 0) this._options.onError(error);
    } finally {
      if (!this._stop.signal.aborted) {
        this._fill();
        this._options.onChange();
      }
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
    while (!tile.slots && this._free.length < parts.length) this._release(this._oldest());
    const slots = tile.slots ?? this._free.splice(-parts.length, parts.length);
    tile.slots = parts.map(([set, first], i) => {
      const { channels, antialias } = set;
      const live = Math.min(rows, set.count - first);
      const part = (numbers, width) => numbers.subarray(first * width, (first + live) * width);
      slots[i].buffers.write(0, part(set.rows, 10), paddedRows(part(set.appearance, channels), channels, slots[i].buffers.stride));
      const transform = composed(tile.frame, composed(tile.facts.axes ?? TILE_FROM_FILE, set.transform));
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
    this._resize(false);
    for (const { buffers } of this.sets) buffers.destroy();
  }
}
