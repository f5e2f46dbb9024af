// What a picture is taken by: cameras as the shaders' per-frame block has them. Twin: glsplat/renderer/frame_block.py.

import { FACTORS, SPREAD } from '../space/light.js';
import { apply, invert, multiply, place, viewmat } from '../space/matrix.js';

const [NEAR, FAR] = [0.01, 1e10]; // metres: those of glsplat.Camera
const VIEW = 32; // floats of a view, and
const REST = 12; // of what the views share

/**
 * A camera of an eye: `transform` (room from eye) and `projection` as WebXR and WebGL have them, for a picture of
 * width x height pixels. `shown`: room from the space that is drawn; a mirror's is a reflection.
 * {rows: 12 numbers, camera (OpenCV axes) from that space; intrinsics: [fx, fy, cx, cy] in pixels; eye: [x, y, z] there}
 */
export function cameraOf({ transform, projection: p }, width, height, shown) {
  const flat = viewmat(transform);
  const rows = multiplied(flat, shown);
  const intrinsics = [(p[0] * width) / 2, (p[5] * height) / 2, ((1 - p[8]) * width) / 2, ((1 + p[9]) * height) / 2];
  return { rows, intrinsics, eye: apply(invert(shown), [...place(transform), 1]).slice(0, 3), width, height };
}

/** A camera of glsplat's own camera files: {w2c (4x4, rows), fx, fy, cx, cy, width, height}. */
export function cameraOfFile({ w2c, fx, fy, cx, cy, width, height }) {
  const m = w2c.flat();
  const eye = [0, 1, 2].map((i) => -(m[i] * m[3] + m[4 + i] * m[7] + m[8 + i] * m[11]));
  return { rows: m.slice(0, 12), intrinsics: [fx, fy, cx ?? width / 2, cy ?? height / 2], eye, width, height };
}

/** The row [x, y, z, w] that orders the splats for all cameras: the first one's axis, at the middle between the eyes. */
export function sortRow(cameras) {
  const [x, y, z] = cameras[0].rows.slice(8, 11);
  const middle = [0, 1, 2].map((i) => cameras.reduce((sum, { eye }) => sum + eye[i], 0) / cameras.length);
  return [x, y, z, -(x * middle[0] + y * middle[1] + z * middle[2])];
}

/**
 * The block of cameras of one size, as floats. `upward`: rows of the picture count from below, as those of a canvas.
 * `knobs`: those of programs.json.
 */
export function frameBlock(cameras, knobs, upward) {
  const out = new Float32Array(VIEW * cameras.length + REST);
  const { width, height } = cameras[0];
  cameras.forEach(({ rows, intrinsics: [fx, fy, cx, cy], eye }, i) => {
    const [mx, my] = [(0.15 * width) / fx, (0.15 * height) / fy];
    out.set(rows, VIEW * i);
    out.set(upward ? [fx, -fy, cx, height - cy] : [fx, fy, cx, cy], VIEW * i + 12);
    out.set([-cx / fx - mx, (width - cx) / fx + mx, -cy / fy - my, (height - cy) / fy + my], VIEW * i + 16);
    out.set(eye, VIEW * i + 20);
    out.set([NEAR, FAR], VIEW * i + 28);
  });
  out.set([...sortRow(cameras), width, height, 2 / width, 2 / height, ...knobs], VIEW * cameras.length);
  return out;
}

/** Rows 0 to 2 of (row-major a) times (column-major b). */
function multiplied(a, b) {
  const columns = multiply([0, 1, 2, 3].flatMap((c) => [a[c], a[4 + c], a[8 + c], a[12 + c]]), b);
  return [0, 1, 2].flatMap((row) => [columns[row], columns[4 + row], columns[8 + row], columns[12 + row]]);
}

const [ONE, STEPS] = [192, 32]; // of a shade's byte

// Light and surfaces as light.glsl reads them. Twins: glsplat/light and glsplat/renderer/stage.py.

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
