/** Finds the box of the Gaussians that the first camera shows: all but floaters, as Python does. */

import { plus } from "./matrices.js";

// A floater lies apart from the object, with few others; `sources/framing.py` says how it is known.
const SPREAD_QUANTILES = [0.1, 0.9];
const MIN_CUBE_SIDE = 1 / 16;
const CUBE_SIDE_SPACINGS = 2;
const MIN_GROUP_SHARE = 0.02;
const LINK_SIGMAS = 2;
const MAX_CUBES_PER_GAUSSIAN = 8;
const GRID_SIZE = 2 ** 19;
const VISIBLE_ALPHA = 1 / 255;
const MAX_GROUPED = 2 ** 17;
const [AXES, VARIANCES] = [[0, 1, 2], [4, 7, 9]]; // columns of a row
const AROUND = [-1, 0, 1].flatMap((x) => [-1, 0, 1].flatMap((y) => [-1, 0, 1].map((z) => [x, y, z])));

/**
 * Return the corners of the box that holds all visible Gaussians but floaters, to their visible
 * edges; null without Gaussians. Invisible Gaussians count if all are invisible.
 * @param {{rows: Float32Array, count: number}} splats Packed rows of ten numbers.
 * @returns {{low: number[], high: number[]} | null}
 */
export function boxAround({ rows, count }) {
  const firsts = Int32Array.from({ length: count }, (_, index) => 10 * index);
  const finite = firsts.filter((row) => AXES.every((axis) => Number.isFinite(rows[row + axis])));
  const visible = finite.filter((row) => rows[row + 3] > 0);
  const chosen = visible.length ? visible : finite;
  if (!chosen.length) return null;
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (const row of withoutFloaters(rows, chosen)) {
    // The edge of a Gaussian is where its alpha falls below what the renderer draws.
    const alpha = Math.min(Math.max(rows[row + 3], VISIBLE_ALPHA), 1);
    const sigmas = Math.sqrt(2 * Math.log(alpha / VISIBLE_ALPHA));
    for (const axis of AXES) {
      const radius = sigmas * deviation(rows, row, axis);
      low[axis] = Math.min(low[axis], rows[row + axis] - radius);
      high[axis] = Math.max(high[axis], rows[row + axis] + radius);
    }
  }
  return { low, high };
}

/**
 * Return the centre of the box around all Gaussians but floaters, half its sides and its diagonal.
 * @typedef {{center: number[], half: number[], reach: number}} Extent
 * @param {{rows: Float32Array, count: number}} splats
 * @returns {Extent}
 */
export function extentOf(splats) {
  const { low, high } = boxAround(splats) ?? { low: [0, 0, 0], high: [0, 0, 0] };
  return extentBetween(low, high);
}

/** Return the extent of several moments. @param {Extent[]} boxes */
export function mergedExtent(boxes) {
  const low = [0, 1, 2].map((i) => Math.min(...boxes.map(({ center, half }) => center[i] - half[i])));
  const high = [0, 1, 2].map((i) => Math.max(...boxes.map(({ center, half }) => center[i] + half[i])));
  return extentBetween(low, high);
}

function extentBetween(low, high) {
  const half = plus(high, -1, low).map((side) => side / 2);
  return { center: plus(low, 1, half), half, reach: Math.hypot(...half) || 1 };
}

/** Return the standard deviation of a Gaussian along an axis. */
function deviation(rows, row, axis) {
  const variance = rows[row + VARIANCES[axis]];
  return variance > 0 && variance < Infinity ? Math.sqrt(variance) : 0;
}

/** Return the rows of Gaussians that are no floaters. */
function withoutFloaters(rows, chosen) {
  if (chosen.length * MIN_GROUP_SHARE <= 1) return chosen; // each is a group that is large enough
  const step = Math.ceil(chosen.length / MAX_GROUPED);
  const sample = chosen.filter((_, index) => index % step === 0);
  const centers = AXES.map((axis) => Float64Array.from(sample, (row) => rows[row + axis]).sort());
  const sigmas = AXES.map((axis) => Float64Array.from(sample, (row) => deviation(rows, row, axis)).sort());
  const low = centers.map((sorted) => quantile(sorted, SPREAD_QUANTILES[0]));
  const sides = AXES.map((axis) => quantile(centers[axis], SPREAD_QUANTILES[1]) - low[axis] + 2 * quantile(sigmas[axis], 0.5));
  const spread = Math.max(...sides);
  const side = spread * Math.max(MIN_CUBE_SIDE, CUBE_SIDE_SPACINGS * sample.length ** (-1 / 3));
  if (!(side > 0 && side < Infinity)) return chosen;
  // 1. The cube of each centre; far Gaussians, and those larger than the object, are left out.
  const cube = [0, 0, 0];
  const placeOf = (value, axis) => Math.floor((value - low[axis]) / side);
  const isPlaced = (row) =>
    AXES.every((axis) => {
      cube[axis] = placeOf(rows[row + axis], axis);
      return Math.abs(cube[axis]) < GRID_SIZE && deviation(rows, row, axis) <= spread;
    });
  const placed = chosen.filter(isPlaced);
  // 2. Of a sample, the cubes that each Gaussian is in or reaches.
  const grid = new CubeGrid();
  for (let index = 0; index < placed.length; index += step) {
    const row = placed[index];
    isPlaced(row);
    grid.add(...cube, 1);
    for (const axis of AXES) {
      const reach = LINK_SIGMAS * deviation(rows, row, axis);
      for (let number = 1; number <= MAX_CUBES_PER_GAUSSIAN; number++) {
        if (!(reach > (number === 1 ? side / 2 : (number - 1) * side))) continue;
        for (const sign of [-1, 1]) {
          const reached = [...cube];
          reached[axis] = placeOf(rows[row + axis] + sign * Math.min(number * side, reach), axis);
          grid.add(...reached, 0);
        }
      }
    }
  }
  // 3. Groups of cubes that touch, and those with enough of the Gaussians.
  const object = new CubeGrid();
  for (const [x, y, z] of grid.largeGroups(MIN_GROUP_SHARE * sample.length)) {
    // The sample may miss cubes at the object's edge.
    for (const [i, j, k] of step > 1 ? AROUND : [[0, 0, 0]]) object.add(x + i, y + j, z + k, 0);
  }
  return object.cubes.length ? placed.filter((row) => isPlaced(row) && object.find(...cube) !== undefined) : chosen;
}

/** Return a number for a column of cubes, below 2⁴². */
const columnKey = (x, y) => (x + 2 * GRID_SIZE) * 4 * GRID_SIZE + y + 2 * GRID_SIZE;

/** Cubes of space that hold Gaussians. */
class CubeGrid {
  constructor() {
    this.cubes = [];
    this._counts = []; // Gaussians of each cube
    this._columns = new Map(); // column of cubes → z → index of the cube
  }

  add(x, y, z, count) {
    const column = this._columns.get(columnKey(x, y)) ?? new Map();
    if (!column.has(z)) {
      this._columns.set(columnKey(x, y), column);
      column.set(z, this.cubes.length);
      this.cubes.push([x, y, z]);
      this._counts.push(0);
    }
    this._counts[column.get(z)] += count;
  }

  /** Return the index of a cube; undefined if it is empty. */
  find(x, y, z) {
    return this._columns.get(columnKey(x, y))?.get(z);
  }

  /** Return the cubes in groups, of cubes that touch, with `least` Gaussians. */
  largeGroups(least) {
    const [seen, result] = [new Uint8Array(this.cubes.length), []];
    for (let first = 0; first < seen.length; first++) {
      if (seen[first]) continue;
      const group = [first];
      seen[first] = 1;
      for (let next = 0; next < group.length; next++) {
        const [x, y, z] = this.cubes[group[next]];
        for (const [i, j, k] of AROUND) {
          const index = this.find(x + i, y + j, z + k);
          if (index !== undefined && !seen[index]) {
            seen[index] = 1;
            group.push(index);
          }
        }
      }
      const size = group.reduce((sum, index) => sum + this._counts[index], 0);
      if (size >= least) for (const index of group) result.push(this.cubes[index]);
    }
    return result;
  }
}

/** Return a quantile of sorted numbers, between two of them as NumPy has it. */
function quantile(sorted, share) {
  const place = share * (sorted.length - 1);
  const [low, high] = [sorted[Math.floor(place)], sorted[Math.ceil(place)]];
  const part = place - Math.floor(place);
  return part < 0.5 ? low + (high - low) * part : high - (high - low) * (1 - part);
}
