// Level `values`: statistics of right rows that a known mistake would explain. Thresholds are those
// of the rules' pages; all findings are warnings.

import {eigenvalues} from './runs.mjs';

const MOST_ROWS = 4000; // whose neighbours are looked for, pair by pair
const BASIS = 0.28209479177387814; // L15, Y₀
const mean = (list) => list.reduce((x, y) => x + y, 0) / list.length;
const share = (list, holds) => list.filter(holds).length / list.length;
const spreadOf = (list) => list.reduce((x, y) => Math.max(x, y), -Infinity) - list.reduce((x, y) => Math.min(x, y), Infinity);

function correlation(a, b) {
  const [ma, mb] = [mean(a), mean(b)];
  const sum = (f) => a.reduce((total, _, i) => total + f(a[i] - ma, b[i] - mb), 0);
  return sum((x, y) => x * y) / Math.sqrt(sum((x) => x * x) * sum((_, y) => y * y));
}

/** For each point its three nearest neighbours. */
function neighbours(points) {
  return points.map((p, i) => {
    const nearest = [];
    for (const [j, q] of points.entries()) {
      if (i === j) continue;
      const distance = (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2;
      if (nearest.length === 3 && distance >= nearest[2][0]) continue;
      nearest.push([distance, j]);
      nearest.sort((x, y) => x[0] - y[0]);
      nearest.length = Math.min(nearest.length, 3);
    }
    return nearest.map(([, j]) => j);
  });
}

/** Mean squared difference to neighbours, over that between any two rows. */
function roughness(values, near) {
  const dimensions = values[0].map((_, k) => values.map((value) => value[k]));
  const variance = dimensions.reduce((sum, list) => sum + mean(list.map((x) => (x - mean(list)) ** 2)), 0);
  const local = mean(values.flatMap((value, i) => near[i].map((j) =>
    value.reduce((sum, x, k) => sum + (x - values[j][k]) ** 2, 0))));
  return local / (2 * variance);
}

/** The mean degree of the coefficients' energy, with coefficient k of channel c at `at(k, c)`. */
function meanDegree(colors, count, at) {
  let [energy, weighted] = [0, 0];
  for (const color of colors) {
    for (let k = 0; k < count; k++) {
      for (let c = 0; c < 3; c++) {
        const square = color[at(k, c)] ** 2;
        energy += square;
        weighted += square * Math.floor(Math.sqrt(k));
      }
    }
  }
  return weighted / energy;
}

export function addSuspicions(rule, {COLORS, SCENE}) {
  const SCENE_COLORS = [...new Set([...SCENE, ...COLORS])];
  /** Check the first frame that draws at least `least` rows. */
  const add = (id, needs, least, check) => rule(id, 'warning', {needs}, (m) => {
    const frame = m.frames.find(({drawn}) => drawn.length >= least);
    const message = frame && check(frame, frame.drawn, m);
    return message ? `${frame.label}: ${message}` : undefined;
  });
  const colors = (frame, rows) => rows.map((i) => [...frame.color(i)]);

  add('GV014', [...COLORS, 'GM005'], 8, (frame, rows) => { // L12, L13
    const count = frame.channels / 3;
    if (frame.isRgb || count === 1) return undefined;
    const all = colors(frame, rows);
    const degree = meanDegree(all, count, (k, c) => 3 * k + c);
    const others = {
      'by channel': (k, c) => c * count + k,
      'interleaved twice': (k, c) => 3 * ((3 * k + c) % count) + Math.floor((3 * k + c) / count),
      'the constant term last': (k, c) => 3 * ((k + count - 1) % count) + c,
    };
    const order = degree >= 0.5 && Object.keys(others).find((name) => meanDegree(all, count, others[name]) <= 0.4);
    return order && `mean degree ${degree.toFixed(2)}; ${order}?`;
  });
  add('GV042', SCENE, 8, (frame, rows) => { // L7.2
    const aligned = share(rows, (i) => [5, 6, 8].every((k) => frame.row(i)[k] === 0));
    const long = share(rows, (i) => {
      const [low, , high] = eigenvalues(frame.row(i).subarray(4));
      return Math.sqrt(high) >= 10 * Math.sqrt(Math.max(low, 0));
    });
    if (aligned < 0.99 || long < 0.6) return undefined;
    // The longest axis against the directions to the neighbours: 1/3 is that of unrelated ones.
    const points = rows.map((i) => frame.row(i));
    const near = neighbours(points);
    const along = mean(points.flatMap((p, i) => {
      const variances = [p[4], p[7], p[9]];
      const [thin, thick] = [Math.min(...variances), Math.max(...variances)];
      const isDisc = Math.sqrt(thin) < 0.5 * Math.sqrt(variances.toSorted((x, y) => x - y)[1]);
      const axis = variances.indexOf(isDisc ? thin : thick);
      return near[i].map((j) => {
        const d = [0, 1, 2].map((k) => points[j][k] - p[k]);
        const cosine = d[axis] ** 2 / (d[0] ** 2 + d[1] ** 2 + d[2] ** 2);
        return isDisc ? cosine : (1 - cosine) / 2;
      });
    }));
    return along / (1 / 3) > 0.55 ? 'no covariance is turned' : undefined;
  });
  add('GV043', SCENE, 8, (frame, rows) => { // L5.1
    const opacities = rows.map((i) => frame.row(i)[3]);
    if (spreadOf(opacities) < 0.08) return undefined;
    if (opacities.every((a) => a >= 0.499 && a <= 0.7321)) return 'a sigmoid of a sigmoid';
    const live = Array.from({length: frame.live}, (_, i) => frame.row(i)[3]);
    const clamped = share(live, (a) => a === 0) >= 0.03 && share(live, (a) => a === 1) >= 0.2
      && share(live, (a) => a > 0 && a < 1) >= 0.05;
    return clamped ? 'clamped logits' : undefined;
  });
  /** The colours that a viewer shows without a direction (L17, L18). */
  const shown = (frame, rows) => colors(frame, rows).map((color) => color.slice(0, 3)
    .map((c) => (frame.isRgb ? c : 0.5 + BASIS * c)));
  add('GV044', [...SCENE_COLORS, 'GV012'], 8, (frame, rows) => { // L18.2
    const pairs = rows.map((i, k) => [frame.row(i)[3], Math.max(...shown(frame, [rows[k]])[0])]);
    if (share(pairs, ([a]) => a < 0.4) < 0.08) return undefined;
    if (share(pairs, ([a, c]) => c <= a + 0.001) < 0.995) return undefined;
    const bright = pairs.filter(([, c]) => c > 0.001).map((pair) => pair.map(Math.log));
    return correlation(bright.map(([a]) => a), bright.map(([, c]) => c)) > 0.7 ? 'premultiplied' : undefined;
  });
  add('GV045', [...SCENE_COLORS, 'GV014'], 8, (frame, rows) => { // L15.1, L17
    if (frame.isRgb) return undefined;
    const terms = colors(frame, rows).flatMap((color) => color.slice(0, 3));
    const seen = terms.map((c) => 0.5 + BASIS * c);
    if (spreadOf(terms) < 1e-3) return undefined; // GV046
    if (terms.every((c) => c >= -0.001 && c <= 1.001) && spreadOf(terms) >= 0.4
      && share(terms, (c) => c < 0.25) >= 0.02) return 'RGB in place of a constant term';
    if (share(terms, (c) => Math.abs(c) > 20) > 0.3) return 'bytes';
    if (share(seen, (c) => c > 1) >= 0.3 && share(seen, (c) => c < 0.499) < 0.02) return 'the offset was added twice';
    if (share(seen, (c) => c < -0.1 || c > 1.1) >= 0.3) return 'divided twice';
    const small = terms.every((c) => Math.abs(c) <= 0.501) && spreadOf(terms) >= 0.4;
    return small && share(terms, (c) => c < 0) >= 0.1 && share(terms, (c) => c > 0) >= 0.1 ? 'multiplied once more' : undefined;
  });
  add('GV046', SCENE_COLORS, 1, (frame, rows) => { // L17
    const all = colors(frame, rows);
    return all.every((color) => color.slice(0, 3).every((c) => c === 0)) ? 'all constant terms are 0' : undefined;
  });
  add('GV047', SCENE_COLORS, 64, (frame, rows) => { // L2.5
    if (rows.length > MOST_ROWS) return undefined;
    const seen = shown(frame, rows);
    const near = neighbours(rows.map((i) => frame.row(i)));
    const here = roughness(seen, near);
    if (!(here > 0.75)) return undefined;
    // Colours or centres that are smooth along the file, or along an axis, were sorted alone.
    const next = rows.map((_, n) => [n + 1 < rows.length ? n + 1 : n - 1]);
    const along = [0, 1, 2].map((k) => rows.map((_, n) => n)
      .toSorted((a, b) => frame.row(rows[a])[k] - frame.row(rows[b])[k]));
    const smooth = roughness(seen, next) < 0.5 || along.some((sorted) => {
      const moved = [];
      sorted.forEach((row, n) => { moved[row] = seen[n]; });
      return roughness(moved, near) < 0.5;
    });
    return smooth ? `roughness ${here.toFixed(2)}` : undefined;
  });
  add('GV048', [...SCENE_COLORS, 'GV014'], 8, (frame, rows) => { // L12
    const count = frame.channels / 3 - 1;
    if (frame.isRgb || count < 1) return undefined;
    const all = colors(frame, rows);
    const column = (at) => all.map((color) => color[at]);
    const together = (at) => mean(Array.from({length: count}, (_, k) => [[0, 1], [0, 2], [1, 2]]
      .map(([c, d]) => correlation(column(at(k, c)), column(at(k, d))))).flat());
    const declared = together((k, c) => 3 + 3 * k + c);
    const other = together((k, c) => 3 + c * count + k);
    return other >= 0.5 && other <= 0.9995 && declared <= 0.35 * other ? 'f_rest by channel' : undefined;
  });
  add('GV063', [...SCENE_COLORS, 'GV012', 'GV046'], 8, (frame, rows) => { // L14.3
    if (!frame.isRgb) return undefined;
    const values = shown(frame, rows).flat();
    if (new Set(values).size < 32) return undefined;
    if (values.every((c) => c >= 0.499 && c <= 0.7321) && spreadOf(values) >= 0.15) return 'a sigmoid of a sigmoid';
    if (values.every((c) => c >= 0 && c <= 0.004)) return 'divided by 255 twice';
    const high = values.toSorted((x, y) => x - y)[Math.floor(0.99 * values.length)];
    return share(values, (c) => c === 0) >= 0.15 && high < 0.55 ? 'without the offset' : undefined;
  });
}
