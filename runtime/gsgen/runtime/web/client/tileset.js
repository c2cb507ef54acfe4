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

const REBUILD = "Pages read tilesets with boxes or spheres: gsgen tiles build";
const MOST_REQUESTS = 6; // at once
const MOST_ATTEMPTS = 4; // of a request that fails by a fault of the network or the server
const FIRST_PAUSE = 500; // milliseconds until the second attempt; doubled after each
const MOST_SPLATS = 1 << 18; // in GPU memory
const MOST_DEGREE = 3;
const GLOBE = [6.25e6, 6.48e6]; // metres from the centre of the globe: up is away from it
// Readers turn glTF content as files (x, y, z) → (−x, −y, z); of a tile, its (x, −z, y) is meant.
const TILE_FROM_FILE = [-1, 0, 0, 0, 0, 0, -1, 0, 0, -1, 0, 0, 0, 0, 0, 1];

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
    /** @type {any} Which file describes the tiles at and below this one; null of explicit tiles. */
    this.subtree = json.subtree ?? firstSubtree(json);
    const contents = this.subtree ? [this.subtree] : (json.contents ?? [json.content ?? []]);
    this.uris = contents.flatMap(({ uri = [] }) => uri);
    this.children = (json.children ?? []).map((child) => new Tile(child, this, base));
    this.base = base;
    /** @type {any[] | null} What holds its splats, once they are loaded. */
    this.slots = null;
    this.needed = 1; // slots, as far as known
    this.isRequested = false; // … or failed
    this.hasFailed = false;
    this.seen = 0; // the last frame whose camera met it
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

/** Return the root tile of a tileset. */
function rootOf({ root, schema }, parent, address) {
  return new Tile({ ...root, schema }, parent, address);
}

/** Return the result of a task, which is tried again after faults that may pass. */
async function persistently(task, signal) {
  for (let attempt = 1; ; attempt++) {
    try {
      return await task();
    } catch (error) {
      if (!error.isTransient || attempt === MOST_ATTEMPTS) throw error;
    }
    await new Promise((resolve) => setTimeout(resolve, FIRST_PAUSE * 2 ** (attempt - 1)));
    signal.throwIfAborted();
  }
}

/** A tileset in a page. */
export class TilesetModel {
  /** Open a tileset, and wait for its coarsest tiles; see the constructor. */
  static async open(kernels, tileset, name, options) {
    const model = new TilesetModel(kernels, tileset, name, options);
    const camera = new OrbitCamera(model.extent, model.up).camera(64, 64);
    await model.update({}, camera);
    while (model.loading && !model._held.size && !options.signal?.aborted) {
      await Promise.race(model._requests);
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
    this._slotRows = slotRows;
    this._options = { ...options, maxError: options.maxError ?? maxError };
    this._root = rootOf(tileset, null, String(new URL(options.source ?? name, document.baseURI)));
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
    /** @type {Set<Promise<void>>} */
    this._requests = new Set();
    this._held = new Set();
    this._frame = 0;
    this._stop = new AbortController();
  }

  /** Choose the tiles of a camera, and request what lacks. */
  async update(_, camera) {
    this._frame += 1;
    const wanted = [];
    this.drawn = this._cut(this._root, camera, wanted) ?? [];
    wanted.sort(([a, errorA], [b, errorB]) => a.level - b.level || errorB - errorA);
    const room = this._room();
    // The first picture is of coarse tiles: finer ones would take their share of the network.
    const first = wanted.find(([tile]) => !tile.hasFailed);
    const deepest = this._held.size ? Infinity : first?.[0].level;
    for (const [tile] of wanted) {
      const isIdle = !tile.slots && !tile.isRequested && this.loading < MOST_REQUESTS;
      if (isIdle && room >= tile.needed && tile.level <= deepest) this._request(tile);
    }
    for (const { buffers } of this.sets) buffers.count = 0;
    for (const { buffers, live } of this.drawn.flatMap(({ slots }) => slots)) buffers.count = live;
    return false;
  }

  /** Return the tiles to draw at and below a tile; null while one of them is not loaded. */
  _cut(tile, camera, wanted) {
    if (!tile.meets(camera)) return [];
    const pixels = tile.pixels(camera);
    const own = tile.slots ? [tile] : tile.uris.length ? null : [];
    tile.seen = this._frame;
    if (tile.uris.length) wanted.push([tile, pixels]);
    if (pixels <= this._options.maxError || !tile.children.length) return own;
    const below = tile.children.map((child) => this._cut(child, camera, wanted));
    const loaded = below.flatMap((tiles) => tiles ?? []);
    if (tile.adds) return own && [...own, ...loaded];
    return below.every(Boolean) || !tile.uris.length ? loaded : own;
  }

  /** How many tiles are being loaded. */
  get loading() {
    return this._requests.size;
  }

  _request(tile) {
    tile.isRequested = true;
    const request = this._load(tile).finally(() => {
      this._requests.delete(request);
      if (!this._stop.signal.aborted) this._options.onChange();
    });
    this._requests.add(request);
  }

  async _load(tile) {
    const { signal } = this._stop;
    try {
      const read = async (uri) => {
        const address = String(new URL(uri, tile.base));
        const { subtree, schema, base } = tile;
        if (subtree) {
          const data = await download(address, undefined, signal);
          return new Tile(subtreeRoot(data, subtree, schema, address), tile, base);
        }
        const { kind, bytes, parts } = await readParts({ name: address, address }, undefined, signal);
        if (kind === "onnx") failing(address)("is a generator, expected splats or a tileset");
        return bytes ? rootOf(parsedJson(bytes), tile, address) : parts;
      };
      const contents = tile.uris.map((uri) => persistently(() => read(uri), signal));
      const loaded = (await Promise.all(contents)).flat();
      if (signal.aborted) return;
      const roots = loaded.filter((part) => part instanceof Tile);
      tile.children.push(...roots);
      if (roots.length) [tile.uris, tile.error] = [[], Infinity]; // other tiles take its place
      this._place(tile, loaded.filter((part) => !(part instanceof Tile)));
      tile.isRequested = false;
    } catch (error) {
      tile.hasFailed = true;
      if (!signal.aborted) this._options.onError(error);
    }
  }

  /** Copy splats into slots; if tiles that the camera needs hold them all, later. */
  _place(tile, splats) {
    const rows = this._slotRows;
    const parts = splats.flatMap((set) => {
      return Array.from({ length: Math.ceil(set.count / rows) }, (_, i) => [set, i * rows]);
    });
    tile.needed = parts.length;
    if (this._room() < parts.length) return;
    while (this._free.length < parts.length) this._evict();
    tile.slots = parts.map(([set, first]) => {
      const { channels, antialias } = set;
      const slot = this._free.pop();
      const live = Math.min(rows, set.count - first);
      const part = (numbers, width) => numbers.subarray(first * width, (first + live) * width);
      slot.buffers.write(0, part(set.rows, 10), paddedRows(part(set.appearance, channels), channels, slot.buffers.stride));
      const transform = composed(tile.frame, composed(TILE_FROM_FILE, set.transform));
      return Object.assign(slot, { transform, live, antialias, degree: degreeOf(channels, "sh") });
    });
    this._held.add(tile);
  }

  /** Return how many slots a tile may take. */
  _room() {
    const unseen = [...this._held].filter(({ seen }) => seen < this._frame);
    const evictable = unseen.reduce((sum, { slots }) => sum + slots.length, 0);
    return this._free.length + evictable;
  }

  /** Free the slots of the tile that was not seen for longest. */
  _evict() {
    const tile = [...this._held].reduce((first, other) => (other.seen < first.seen ? other : first));
    this._free.push(...tile.slots);
    this._held.delete(tile);
    tile.slots = null;
  }

  destroy() {
    this._stop.abort();
    for (const { buffers } of this.sets) buffers.destroy();
  }
}
