/** Small matrices in float64: 4×4 and 3×3 arrays, row by row, that act on column vectors. */

/** @typedef {number[]} Matrix */

export function times(a, x) {
  return [0, 1, 2].map((i) => a[3 * i] * x[0] + a[3 * i + 1] * x[1] + a[3 * i + 2] * x[2]);
}

/** Return the product of two 3×3 matrices. @param {Matrix} a @param {Matrix} b @returns {Matrix} */
export function product(a, b) {
  return [0, 3, 6].flatMap((first) => times(transposed(b), a.slice(first, first + 3)));
}

export function transposed(a) {
  return [a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]];
}

/** Return the upper left 3×3 part of a 4×4 matrix. @param {readonly number[]} m @returns {Matrix} */
export function linearPart(m) {
  return [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
}

/** Return a 4×4 matrix by columns as the same by rows, and the other way round. @param {number[]} m */
export function transposed4(m) {
  return m.map((_, i) => m[4 * (i % 4) + Math.floor(i / 4)]);
}

/** Return the product of two affine 4×4 matrices. @param {readonly number[]} a @param {readonly number[]} b */
export function composed(a, b) {
  const linear = product(linearPart(a), linearPart(b));
  const [x, y, z] = moved(a, [b[3], b[7], b[11]]);
  return [...linear.slice(0, 3), x, ...linear.slice(3, 6), y, ...linear.slice(6), z, 0, 0, 0, 1];
}

/** Return an affine 4×4 matrix times a point. @param {readonly number[]} m @param {number[]} point */
export function moved(m, point) {
  return plus(times(linearPart(m), point), 1, [m[3], m[7], m[11]]);
}

/** Solve a x = b by Cramer's rule. @param {Matrix} a 3×3 @param {number[]} b */
export function solve(a, b) {
  const [p, q, r] = [a.slice(0, 3), a.slice(3, 6), a.slice(6)];
  const first = cross(q, r).map((part) => b[0] * part);
  const sum = plus(plus(first, b[1], cross(r, p)), b[2], cross(p, q));
  return sum.map((part) => part / dot(p, cross(q, r)));
}

/**
 * Write a Gaussian in the axes to which an affine 4×4 matrix leads: the centre and the covariance, A Σ Aᵀ.
 * @param {readonly number[]} m
 * @param {Float32Array} rows Ten numbers each: x y z opacity xx xy xz yy yz zz; those at `from` are read.
 * @param {Float32Array | Float64Array} placed Those at `to` are written.
 */
export function placeRow(m, rows, from, placed, to) {
  const x = rows[from], y = rows[from + 1], z = rows[from + 2], xx = rows[from + 4], xy = rows[from + 5];
  const xz = rows[from + 6], yy = rows[from + 7], yz = rows[from + 8], zz = rows[from + 9];
  placed[to + 3] = rows[from + 3];
  for (let axis = 0, place = to + 4; axis < 3; axis++) {
    const a = m[4 * axis], b = m[4 * axis + 1], c = m[4 * axis + 2];
    placed[to + axis] = a * x + b * y + c * z + m[4 * axis + 3];
    const p = a * xx + b * xy + c * xz, q = a * xy + b * yy + c * yz, r = a * xz + b * yz + c * zz;
    for (let other = axis; other < 3; other++, place++) {
      placed[place] = p * m[4 * other] + q * m[4 * other + 1] + r * m[4 * other + 2];
    }
  }
}

/** Return the inverse of an affine 4×4 matrix. @param {readonly number[]} m */
export function inverted(m) {
  const linear = linearPart(m);
  const [a, b, c] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => solve(linear, axis));
  const [x, y, z] = solve(linear, [m[3], m[7], m[11]]);
  return [a[0], b[0], c[0], -x, a[1], b[1], c[1], -y, a[2], b[2], c[2], -z, 0, 0, 0, 1];
}

/**
 * Return the axes along which a 3×3 matrix A stretches, as columns, and by how much: the square roots
 * of the eigenvalues of AᵀA, which Jacobi rotations find.
 */
function stretchesOf(a) {
  const square = product(transposed(a), a);
  let vectors = [1, 0, 0, 0, 1, 0, 0, 0, 1];
  for (let sweep = 0; sweep < 30; sweep++) {
    for (const [p, q] of [[0, 1], [0, 2], [1, 2]]) {
      const off = square[3 * p + q];
      if (off === 0) continue;
      const theta = (square[4 * q] - square[4 * p]) / (2 * off);
      const t = (theta < 0 ? -1 : 1) / (Math.abs(theta) + Math.hypot(theta, 1));
      const c = 1 / Math.hypot(t, 1);
      const turn = [1, 0, 0, 0, 1, 0, 0, 0, 1];
      turn[4 * p] = turn[4 * q] = c;
      turn[3 * p + q] = t * c;
      turn[3 * q + p] = -t * c;
      square.splice(0, 9, ...product(product(transposed(turn), square), turn));
      square[3 * p + q] = square[3 * q + p] = 0;
      vectors = product(vectors, turn);
    }
  }
  return { vectors, lengths: [0, 4, 8].map((i) => Math.sqrt(Math.max(square[i], 0))) };
}

/**
 * Return the stretch S of a 3×3 matrix A = Q S (polar decomposition), over its largest eigenvalue.
 * @returns {Matrix}
 */
export function relativeStretch(a) {
  const { vectors, lengths } = stretchesOf(a);
  const largest = Math.max(...lengths);
  const [x, y, z] = lengths.map((length) => length / largest);
  return product(product(vectors, [x, 0, 0, 0, y, 0, 0, 0, z]), transposed(vectors));
}

/** Return the rotation nearest to an invertible 3×3 matrix: Q of A = Q S, which mirrors nothing. */
export function nearestRotation(a) {
  const { vectors, lengths } = stretchesOf(a);
  const isMirror = determinant(a) < 0;
  const least = lengths.indexOf(Math.min(...lengths));
  const [x, y, z] = lengths.map((length, i) => (isMirror && i === least ? -1 : 1) / length);
  return product(product(product(a, vectors), [x, 0, 0, 0, y, 0, 0, 0, z]), transposed(vectors));
}

export function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

export function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

export function normalized(a) {
  const length = Math.sqrt(dot(a, a));
  return [a[0] / length, a[1] / length, a[2] / length];
}

/** Return a + s b. @param {number[]} a @param {number} s @param {number[]} b */
export function plus(a, s, b) {
  return [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
}

/** Return the determinant of a 3×3 matrix: the volume of a unit cube that it maps. @param {Matrix} a */
export function determinant(a) {
  return dot(a.slice(0, 3), cross(a.slice(3, 6), a.slice(6)));
}

/** Return the rotation of a unit quaternion w, x, y, z. @param {number[]} quaternion */
export function rotationOf([w, x, y, z]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
}

/** Return the rotation about a unit axis (Rodrigues' formula). @param {Matrix} axis */
export function rotation([x, y, z], angle) {
  const [c, s, d] = [Math.cos(angle), Math.sin(angle), 1 - Math.cos(angle)];
  return [
    c + d * x * x, d * x * y - s * z, d * x * z + s * y,
    d * y * x + s * z, c + d * y * y, d * y * z - s * x,
    d * z * x - s * y, d * z * y + s * x, c + d * z * z,
  ];
}

export const IDENTITY = Object.freeze([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
