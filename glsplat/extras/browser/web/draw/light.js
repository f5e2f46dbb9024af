// Light and surfaces as light.glsl reads them. Twins: glsplat/light and glsplat/renderer/stage.py.

import { FACTORS, SPREAD } from '../space/light.js';

const [ONE, STEPS] = [192, 32]; // of a shade's byte

/** Return `light` [11] of light.glsl for {ambient: [[r, g, b] x 9], sun: {direction, color} or null}. */
export function uniformsOf({ ambient, sun }) {
  const out = new Float32Array(44);
  ambient.forEach((rgb, k) => rgb.forEach((v, c) => (out[4 * k + c] = v * FACTORS[k] * SPREAD[k])));
  if (sun) {
    out.set(sun.direction, 36);
    out.set(sun.color.map((v) => v / Math.PI), 40);
  }
  return out;
}

/**
 * Write two texels per splat for light.glsl into `out` from float `first` on: normal in its own axes (0: no surface),
 * occlusion, 1 / shade.
 */
export function fillSurfaces(out, { count, quats, scales, surface }, first) {
  if (!surface) return;
  const { normals, occlusion, shade } = surface;
  for (let i = 0, to = first; i < count; i++, to += 8) {
    const n = [0, 1, 2].map((k) => Math.max(normals[3 * i + k], -127));
    const size = Math.hypot(...n);
    if (size > 0) out.set(inAxes(n.map((v) => v / size), quats.subarray(4 * i, 4 * i + 4), scales.subarray(3 * i, 3 * i + 3)), to);
    out[to + 3] = occlusion[i] / 255;
    for (let c = 0; c < 3; c++) out[to + 4 + c] = shade ? 2 ** ((ONE - shade[3 * i + c]) / STEPS) : 1;
  }
}

/** Return a direction in the axes of a splat; a negative scale reverses its axis (rotations.signed_axes). */
function inAxes([x, y, z], [w, a, b, c], scales) {
  const columns = [
    [1 - 2 * (b * b + c * c), 2 * (a * b + w * c), 2 * (a * c - w * b)],
    [2 * (a * b - w * c), 1 - 2 * (a * a + c * c), 2 * (b * c + w * a)],
    [2 * (a * c + w * b), 2 * (b * c - w * a), 1 - 2 * (a * a + b * b)],
  ];
  const signs = [0, 1, 2].map((k) => (scales[k] < 0 ? -1 : 1));
  return columns.map(([p, q, r], k) => (scales[k] === 0 ? signs[(k + 1) % 3] * signs[(k + 2) % 3] : signs[k]) * (p * x + q * y + r * z));
}
