// 4x4 matrices as arrays of 16 numbers, column by column, as WebXR and WebGL have them. Points are [x, y, z] in metres.

export const IDENTITY = Object.freeze([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

/** The world reflected in x: what the server applies for `"mirror": true`. */
export const FLIP_X = Object.freeze([-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

export function multiply(a, b) {
  const out = new Array(16);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[k * 4 + row] * b[column * 4 + k];
      out[column * 4 + row] = sum;
    }
  }
  return out;
}

/** The inverse of a rotation or reflection with a translation: any matrix whose axes are orthonormal. */
export function invert(m) {
  const out = [m[0], m[4], m[8], 0, m[1], m[5], m[9], 0, m[2], m[6], m[10], 0, 0, 0, 0, 1];
  for (let row = 0; row < 3; row++) {
    out[12 + row] = -(out[row] * m[12] + out[4 + row] * m[13] + out[8 + row] * m[14]);
  }
  return out;
}

/** The homogeneous point [x, y, z, w] moved by m: four numbers. */
export function apply(m, [x, y, z, w = 1]) {
  return [0, 1, 2, 3].map((row) => m[row] * x + m[4 + row] * y + m[8 + row] * z + m[12 + row] * w);
}

/** The point [x, y, z] moved by a matrix whose last row is 0 0 0 1. */
export function movePoint(m, point) {
  return apply(m, point).slice(0, 3);
}

export function translation([x, y, z]) {
  return [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1];
}

/** A turn about the vertical, in radians, counter-clockwise seen from above. */
export function turnY(angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return [c, 0, -s, 0, 0, 1, 0, 0, s, 0, c, 0, 0, 0, 0, 1];
}

/** The reflection in the plane through `point` with the unit normal `n`. */
export function reflection(point, n) {
  const out = [...IDENTITY];
  for (let column = 0; column < 3; column++) {
    for (let row = 0; row < 3; row++) out[column * 4 + row] -= 2 * n[row] * n[column];
    out[12 + column] = 2 * dot(point, n) * n[column];
  }
  return out;
}

/** A pose [x, y, z, qx, qy, qz, qw] as a matrix. */
export function fromPose([px, py, pz, x, y, z, w]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0,
    2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0,
    2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0,
    px, py, pz, 1,
  ];
}

/** The protocol's `viewmat` of an eye (world to camera, OpenCV axes, row by row) from its pose in the room. */
export function viewmat(transform) {
  const m = invert(transform);
  const rows = [0, 1, 2, 3].map((row) => [m[row], m[4 + row], m[8 + row], m[12 + row]]);
  return [...rows[0], ...rows[1].map((v) => -v), ...rows[2].map((v) => -v), ...rows[3]];
}

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const length = (a) => Math.hypot(a[0], a[1], a[2]);

export function unit(a) {
  const size = length(a);
  return size > 0 ? scale(a, 1 / size) : [0, 0, 0];
}

export const place = (m) => [m[12], m[13], m[14]];
export const axis = (m, column) => [m[4 * column], m[4 * column + 1], m[4 * column + 2]];
