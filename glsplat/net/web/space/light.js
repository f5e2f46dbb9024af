// Light on avatars: nine coefficients of ambient light and a sun, turned and as the wire has them. Twin: glsplat/light.

const [C0, C1, XY, ZZ, XX] = [0.28209479177387814, 0.4886025119029199, 1.0925484305920792, 0.31539156525252005, 0.5462742152960396];
/**
 * Constants of the nine real spherical harmonics 1, y, z, x, xy, yz, 3zz-1, xz, xx-yy, without the Condon-Shortley
 * sign.
 */
export const FACTORS = [C0, C1, C1, C1, XY, XY, ZZ, XY, XX];
/** Factors from radiance to irradiance over pi, by coefficient. */
export const SPREAD = [1, 2 / 3, 2 / 3, 2 / 3, 0.25, 0.25, 0.25, 0.25, 0.25];

/** Return the nine polynomials at a unit direction. */
export const polynomials = ([x, y, z]) => [1, y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y];

/** Return the light moved by a matrix (by columns) with orthonormal axes, a mirror's too. */
export function turned({ ambient, sun }, m) {
  const forth = ([x, y, z]) => [0, 1, 2].map((row) => m[row] * x + m[4 + row] * y + m[8 + row] * z);
  const out = ambient.map(() => [0, 0, 0]);
  for (let c = 0; c < 3; c++) turnedChannel(ambient.map((rgb) => rgb[c]), forth).forEach((v, k) => (out[k][c] = v));
  return { ambient: out, sun: sun && { ...sun, direction: forth(sun.direction) } };
}

/** Return the light for a request, rounded to save bytes. */
export function onWire({ ambient, sun }) {
  const round = (v) => Math.round(v * 1e4) / 1e4;
  return { ambient: ambient.map((rgb) => rgb.map(round)), ...(sun ? { sun: { direction: sun.direction.map(round), color: sun.color.map(round) } } : {}) };
}

/** Turn one channel: degree 1 is a vector, degree 2 a symmetric matrix with trace 0. */
function turnedChannel([c0, y, z, x, xy, yz, zz, xz, xx], forth) {
  const [vx, vy, vz] = forth([x, y, z]);
  const [a, b, c] = [(XY * xy) / 2, (XY * yz) / 2, (XY * xz) / 2];
  const rows = [[XX * xx - ZZ * zz, a, c], [a, -XX * xx - ZZ * zz, b], [c, b, 2 * ZZ * zz]].map(forth);
  const [p, q, r] = [0, 1, 2].map((k) => forth(rows.map((row) => row[k])));
  return [c0, vy, vz, vx, (2 * p[1]) / XY, (2 * q[2]) / XY, r[2] / (2 * ZZ), (2 * p[2]) / XY, (p[0] - q[1]) / (2 * XX)];
}
