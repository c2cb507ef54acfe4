/** Finds the box of the Gaussians that the first camera shows: all but floaters, as Python does. */

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
  const finite = [];
  for (let row = 0; row < 10 * count; row += 10) {
    if (Number.isFinite(rows[row]) && Number.isFinite(rows[row + 1]) && Number.isFinite(rows[row + 2])) finite.push(row);
  }
  const visible = finite.filter((row) => rows[row + 3] > 0);
  const chosen = visible.length ? visible : finite;
  if (!chosen.length) return null;
  const centers = AXES.map((axis) => Float64Array.from(chosen, (row) => rows[row + axis]));
  const sigmas = VARIANCES.map((column) => Float64Array.from(chosen, (row) => deviation(rows[row + column])));
  const retained = retainedOf(centers, sigmas);
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (let i = 0; i < chosen.length; i++) {
    if (retained && !retained[i]) continue;
    // The edge of a Gaussian is where its alpha falls below what the renderer draws.
    const alpha = Math.min(Math.max(rows[chosen[i] + 3], VISIBLE_ALPHA), 1);
    const sigmaCount = Math.sqrt(2 * Math.log(alpha / VISIBLE_ALPHA));
    for (const axis of AXES) {
      const radius = sigmas[axis][i] * sigmaCount;
      low[axis] = Math.min(low[axis], centers[axis][i] - radius);
      high[axis] = Math.max(high[axis], centers[axis][i] + radius);
    }
  }
  return { low, high };
}

function deviation(variance) {
  return variance > 0 && variance < Infinity ? Math.sqrt(variance) : 0;
}

/** Return which Gaussians are no floaters; null where all are. */
function retainedOf(centers, sigmas) {
  const count = centers[0].length;
  if (count * MIN_GROUP_SHARE <= 1) return null; // each Gaussian is a group that is large enough
  const step = Math.ceil(count / MAX_GROUPED);
  const sampleCount = Math.ceil(count / step);
  const sorted = (numbers) => numbers.filter((_, i) => i % step === 0).sort();
  const bounds = centers.map((numbers) => SPREAD_QUANTILES.map((share) => quantile(sorted(numbers), share)));
  const low = bounds.map(([least]) => least);
  const medians = sigmas.map((numbers) => quantile(sorted(numbers), 0.5));
  const spread = Math.max(...bounds.map(([least, most], axis) => most - least + 2 * medians[axis]));
  const side = spread * Math.max(MIN_CUBE_SIDE, CUBE_SIDE_SPACINGS * sampleCount ** (-1 / 3));
  if (!(side > 0 && side < Infinity)) return null;
  // 1. The cube of each centre; far Gaussians, and those larger than the object, are left out.
  const cubeAt = (point) => point.map((value, axis) => Math.floor((value - low[axis]) / side));
  const cubes = [];
  for (let i = 0; i < count; i++) {
    const cube = cubeAt(AXES.map((axis) => centers[axis][i]));
    const isInGrid = cube.every((place) => Math.abs(place) < GRID_SIZE);
    if (isInGrid && AXES.every((axis) => sigmas[axis][i] <= spread)) cubes.push({ i, cube });
  }
  // 2. Of a sample, the cubes that each Gaussian is in or reaches.
  const grid = new CubeGrid();
  for (const { i, cube } of cubes.filter((_, number) => number % step === 0)) {
    grid.add(cube, 1);
    const center = AXES.map((axis) => centers[axis][i]);
    for (const axis of AXES) {
      const reach = LINK_SIGMAS * sigmas[axis][i];
      for (let number = 1; number <= MAX_CUBES_PER_GAUSSIAN; number++) {
        if (!(reach > (number === 1 ? side / 2 : (number - 1) * side))) continue;
        const offset = Math.min(number * side, reach);
        for (const sign of [-1, 1]) grid.add(cubeAt(center.map((value, k) => value + (k === axis ? sign * offset : 0))), 0);
      }
    }
  }
  // 3. Groups of cubes that touch, and those with enough of the Gaussians.
  const cubesOfObject = grid.largeGroups(MIN_GROUP_SHARE * sampleCount);
  if (!cubesOfObject.size) return null;
  const isNear = (cube) => AROUND.some((step) => cubesOfObject.has(grid.find(cube, step)));
  const retained = new Uint8Array(count);
  for (const { i, cube } of cubes) {
    // The sample may miss cubes at the object's edge.
    retained[i] = Number(step > 1 ? isNear(cube) : cubesOfObject.has(grid.find(cube)));
  }
  return retained;
}

/** Cubes of space that hold Gaussians, with their numbers. */
class CubeGrid {
  constructor() {
    this._numbers = new Map(); // column of cubes → z → number of the cube
    this._cubes = [];
    this._counts = [];
  }

  add(cube, count) {
    const column = this._column(cube[0], cube[1]);
    if (!this._numbers.has(column)) this._numbers.set(column, new Map());
    const numbers = this._numbers.get(column);
    if (!numbers.has(cube[2])) {
      numbers.set(cube[2], this._cubes.length);
      this._cubes.push(cube);
      this._counts.push(0);
    }
    this._counts[numbers.get(cube[2])] += count;
  }

  /** Return the number of a cube, or of one beside it; undefined if it is empty. */
  find(cube, step = [0, 0, 0]) {
    return this._numbers.get(this._column(cube[0] + step[0], cube[1] + step[1]))?.get(cube[2] + step[2]);
  }

  /** Return the numbers of the cubes in groups, of cubes that touch, with `least` Gaussians. */
  largeGroups(least) {
    const [seen, result] = [new Uint8Array(this._cubes.length), new Set()];
    for (let first = 0; first < seen.length; first++) {
      if (seen[first]) continue;
      const group = [first];
      seen[first] = 1;
      for (let next = 0; next < group.length; next++) {
        for (const step of AROUND) {
          const number = this.find(this._cubes[group[next]], step);
          if (number !== undefined && !seen[number]) {
            seen[number] = 1;
            group.push(number);
          }
        }
      }
      const size = group.reduce((sum, number) => sum + this._counts[number], 0);
      if (size >= least) group.forEach((number) => result.add(number));
    }
    return result;
  }

  _column(x, y) {
    return (x + 2 * GRID_SIZE) * 4 * GRID_SIZE + y + 2 * GRID_SIZE; // below 2⁴²
  }
}

/** Return a quantile of sorted numbers, between two of them as NumPy has it. */
function quantile(sorted, share) {
  const place = share * (sorted.length - 1);
  const [low, high] = [sorted[Math.floor(place)], sorted[Math.ceil(place)]];
  const part = place - Math.floor(place);
  return part < 0.5 ? low + (high - low) * part : high - (high - low) * (1 - part);
}
