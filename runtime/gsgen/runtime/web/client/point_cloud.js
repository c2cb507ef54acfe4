/** Turns coloured points into round Gaussians, sized by the distance to three neighbours. */

const NEIGHBOURS = 3;
const OPACITY = 0.8;
const LARGEST = 4; // median sizes: isolated points would hide the others

/** @param {import("./row_writer.js").RowWriter} writer @param {Float32Array} points */
export async function writePoints(writer, points, colors) {
  const spacing = spacings(points);
  const sorted = Float64Array.from(spacing).sort();
  const median = (sorted[(sorted.length - 1) >> 1] + sorted[sorted.length >> 1]) / 2;
  for await (const [first, rows] of writer.batches()) {
    for (let row = first; row < first + rows; row++) {
      const variance = (0.5 * Math.min(spacing[row], LARGEST * median)) ** 2;
      writer.rows.set(points.subarray(3 * row, 3 * row + 3), 10 * writer.used);
      writer.rows.set([OPACITY, variance, 0, 0, variance, 0, variance], 10 * writer.used + 3);
      writer.appearance.set(colors.subarray(3 * row, 3 * row + 3), writer.stride * writer.used);
      writer.isValid = true;
      writer.keep();
    }
  }
  writer.end();
}

/** Return the root mean square distance of each point to its nearest neighbours. */
function spacings(points) {
  const count = points.length / 3;
  const wanted = Math.min(NEIGHBOURS, count - 1);
  const result = new Float64Array(count).fill(1e-2);
  if (wanted < 1) return result;
  const order = Uint32Array.from({ length: count }, (_, i) => i).sort((a, b) => points[3 * a] - points[3 * b]);
  const [x, y, z] = [0, 1, 2].map((axis) => Float64Array.from(order, (i) => points[3 * i + axis]));
  const nearest = new Float64Array(wanted); // squares of distances, ascending
  for (let own = 0; own < count; own++) {
    nearest.fill(Infinity);
    // Along x, neighbours that are farther than the nearest so far end the search.
    for (const step of [-1, 1]) {
      for (let other = own + step; other >= 0 && other < count; other += step) {
        const dx = x[other] - x[own], dy = y[other] - y[own], dz = z[other] - z[own];
        if (dx * dx >= nearest[wanted - 1]) break;
        const square = dx * dx + dy * dy + dz * dz;
        let place = wanted - 1;
        if (square >= nearest[place]) continue;
        for (; place > 0 && nearest[place - 1] > square; place--) nearest[place] = nearest[place - 1];
        nearest[place] = square;
      }
    }
    result[order[own]] = Math.sqrt(nearest.reduce((sum, square) => sum + square) / wanted);
  }
  return result;
}
