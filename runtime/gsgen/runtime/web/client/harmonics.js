/** Real spherical harmonics, in the signs of 3DGS. */

const [A, B, C, D] = [0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154];
const [E, F, G, H] = [1.0925484305920792, 0.31539156525252005, 0.5462742152960396, 0.4886025119029199];
const basis = new Float64Array(16);
basis[0] = 0.28209479177387814;

/**
 * Write the colour that coefficients from an index on give a direction: 0.5 and the sum of the harmonics.
 * @param {number[]} s 3×3, by which the direction is stretched; then it is normalised.
 * @param {number} degree From 0 to 3.
 */
export function writeColor(s, dx, dy, dz, degree, coefficients, from, colors, to) {
  let x = s[0] * dx + s[1] * dy + s[2] * dz, y = s[3] * dx + s[4] * dy + s[5] * dz, z = s[6] * dx + s[7] * dy + s[8] * dz;
  const length = Math.sqrt(x * x + y * y + z * z);
  const xx = (x /= length) * x, yy = (y /= length) * y, zz = (z /= length) * z;
  [basis[1], basis[2], basis[3]] = [-H * y, H * z, -H * x];
  [basis[4], basis[5], basis[6]] = [E * x * y, -E * y * z, F * (2 * zz - xx - yy)];
  [basis[7], basis[8]] = [-E * x * z, G * (xx - yy)];
  [basis[9], basis[10], basis[11]] = [-A * y * (3 * xx - yy), B * x * y * z, -C * y * (4 * zz - xx - yy)];
  [basis[12], basis[13]] = [D * z * (2 * zz - 3 * xx - 3 * yy), -C * x * (4 * zz - xx - yy)];
  [basis[14], basis[15]] = [(B / 2) * z * (xx - yy), -A * x * (xx - 3 * yy)];
  for (let part = 0; part < 3; part++) {
    let sum = 0.5;
    for (let index = 0; index < (degree + 1) ** 2; index++) sum += basis[index] * coefficients[from + 3 * index + part];
    colors[to + part] = sum;
  }
}
