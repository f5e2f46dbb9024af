// The triangles of a place: nine numbers a vertex, position, texel (and 1 on the floor), colour (below 0: the texture's).

import { cross, dot, subtract } from '../space/matrix.js';
import { ATLAS, FACES, random, shown } from './bake.js';

const OF_TEXTURE = [-1, -1, -1];
const PLAIN = [0, 0, 0];
const FRAME = { wide: 0.055, deep: 0.035, colour: [0.2, 0.115, 0.052] }; // around a mirror's glass, metres
const FEET = { reach: 0.16, wide: 0.05, high: 0.04 };
const SEAM = 0.02; // metres by which a wall goes on behind its neighbours: no light falls through
const SASH = { wide: 0.07, deep: 0.09, bar: 0.04 }; // of a window
const HIDDEN = SASH.wide / 2;
const [HILLS, FAR] = [48, 44]; // pieces around, metres away: nearer than the far plane of a headset, 50

/** Floats of what one of LOOKS has of triangles, all facing inwards: culled from outside, one looks into the room. */
export function roomMesh(look) {
  const { walls, half: [w, h, d], bench, windows } = look;
  const out = [];
  face(out, [[-w, 0, -d], [w, 0, -d], [w, 0, d], [-w, 0, d]], [0, 1, 0], FACES.floor, [[0, 0], [1, 0], [1, 1], [0, 1]], 1);
  if (walls) {
    face(out, [[-w, h, -d], [w, h, -d], [w, h, d], [-w, h, d]], [0, -1, 0], FACES.ceiling, [[0, 0], [1, 0], [1, 1], [0, 1]]);
    for (let side = 0; side < 4; side++) wall(out, side, look);
    for (const pane of windows) sash(out, pane, look);
  }
  if (bench) blockOf(out, (a, b, c) => [a, b, c], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], bench.from, bench.to, bench.colour);
  if (look.sky.hills) hills(out, look.sky);
  return new Float32Array(out);
}

/** Points {place, size in texel.x, colour} of the stars, as a mesh. */
export function starMesh({ sky: { stars } }) {
  const out = [];
  for (let i = 0; i < stars; i++) {
    const [a, y] = [2 * Math.PI * random(i, 1), 0.09 + 0.9 * random(i, 2)];
    const level = Math.sqrt(1 - y * y);
    const bright = 0.25 + 0.65 * random(i, 3) ** 4;
    out.push(FAR * level * Math.cos(a), FAR * y, FAR * level * Math.sin(a), bright > 0.6 ? 2.5 : 1.5, 0, 0, bright, bright, 1.06 * bright);
  }
  return new Float32Array(out);
}

/**
 * The frame and the feet of a mirror whose glass has these corners (around it from the lower left), and looks along `normal`;
 * `lit` [3]: of its colour, what the light of the place leaves.
 */
export function mirrorMesh(glass, normal, lit = [1, 1, 1]) {
  const [low, right, , left] = glass;
  const [u, width] = span(low, right);
  const [v, height] = span(low, left);
  const at = (a, b, c) => [0, 1, 2].map((i) => low[i] + a * u[i] + b * v[i] + c * normal[i]);
  const out = [];
  const { wide, deep } = FRAME;
  const colour = FRAME.colour.map((value, k) => value * lit[k]);
  const bar = (from, to) => blockOf(out, at, [u, v, normal], from, to, colour);
  const [front, back] = [0.006, -deep];
  bar([-wide, -wide, back], [0, height + wide, front]);
  bar([width, -wide, back], [width + wide, height + wide, front]);
  bar([0, height, back], [width, height + wide, front]);
  bar([0, -wide, back], [width, 0, front]);
  for (const side of [0.12 * width, 0.88 * width]) {
    bar([side - FEET.wide / 2, -low[1], back], [side + FEET.wide / 2, FEET.high - low[1], FEET.reach]);
  }
  return new Float32Array(out);
}

/** A flat thing with these corners around it. */
export function flatMesh(corners, normal) {
  const out = [];
  quad(out, corners, normal, [PLAIN, PLAIN, PLAIN, PLAIN], PLAIN);
  return new Float32Array(out);
}

/** Floor as far as the shadows [x, z, radius, strength] reach. */
export function floorMesh(blobs) {
  const reach = (of) => blobs.map(([x, z, radius]) => of([x, z], 2.4 * radius));
  const [a, c] = [Math.min(...reach(([x], r) => x - r)), Math.max(...reach(([x], r) => x + r))];
  const [b, e] = [Math.min(...reach(([, z], r) => z - r)), Math.max(...reach(([, z], r) => z + r))];
  return flatMesh([[a, 0, b], [a, 0, e], [c, 0, e], [c, 0, b]], [0, 1, 0]);
}

/** Two triangles that are seen from where the normal points. */
function quad(out, corners, normal, texels, colour) {
  const order = dot(cross(subtract(corners[1], corners[0]), subtract(corners[2], corners[0])), normal) < 0 ? [0, 2, 1, 0, 3, 2] : [0, 1, 2, 0, 2, 3];
  for (const i of order) out.push(...corners[i], ...texels[i], ...colour);
}

/** A part of a face of the texture; `parts` are 0 to 1 in its `rect`. */
function face(out, corners, normal, [left, top, width, height], parts, floor = 0) {
  const inset = (part, size) => 0.5 + part * (size - 1); // the middles of the outer texels: no neighbour is read
  const texels = parts.map(([u, v]) => [(left + inset(u, width)) / ATLAS.width, (top + inset(v, height)) / ATLAS.height, floor]);
  quad(out, corners, normal, texels, OF_TEXTURE);
}

/** {at(along, up, out): a point, normal, reach: half of how long it is} of a wall. */
function wallOf(side, [w, , d]) {
  const sign = side % 2 ? 1 : -1;
  if (side < 2) return { at: (a, y, c) => [sign * (w - c), y, a], axes: [[0, 0, 1], [0, 1, 0], [-sign, 0, 0]], normal: [-sign, 0, 0], reach: d };
  return { at: (a, y, c) => [a, y, sign * (d - c)], axes: [[1, 0, 0], [0, 1, 0], [0, 0, -sign]], normal: [0, 0, -sign], reach: w };
}

/** A wall around its windows. */
function wall(out, side, { half, windows }) {
  const { at, normal, reach } = wallOf(side, half);
  // the edges of a wall lie within the sashes: on their faces they would shine through in single pixels
  const own = windows.filter(([which]) => which === side)
    .map(([which, from, to, bottom, top]) => [which, from - HIDDEN, to + HIDDEN, bottom - HIDDEN, top + HIDDEN]);
  const cuts = (from, to, marks) => [...new Set([from, ...marks, to])].sort((a, b) => a - b);
  const along = cuts(-reach - SEAM, reach + SEAM, own.flatMap(([, a, b]) => [a, b]));
  const up = cuts(-SEAM, half[1] + SEAM, own.flatMap(([, , , a, b]) => [a, b]));
  for (let i = 1; i < along.length; i++) {
    for (let k = 1; k < up.length; k++) {
      const [a, b, low, high] = [along[i - 1], along[i], up[k - 1], up[k]];
      if (own.some(([, from, to, bottom, top]) => a >= from && b <= to && low >= bottom && high <= top)) continue;
      const parts = [[a, low], [b, low], [b, high], [a, high]];
      face(out, parts.map(([x, y]) => at(x, y, 0)), normal, FACES.walls[side], parts.map(([x, y]) => [x / reach / 2 + 0.5, y / half[1]]));
    }
  }
}

/** The frame and the bars of a window. */
function sash(out, [side, from, to, bottom, top], { half, frame }) {
  const { at, axes } = wallOf(side, half);
  const { wide, deep, bar } = SASH;
  const [middle, rail] = [(from + to) / 2, bottom + 0.68 * (top - bottom)];
  const put = (a, b) => blockOf(out, at, axes, a, b, frame);
  put([from - wide, bottom - wide, -deep], [from, top + wide, 0.03]);
  put([to, bottom - wide, -deep], [to + wide, top + wide, 0.03]);
  put([from, top, -deep], [to, top + wide, 0.03]);
  put([from, bottom - wide, -deep], [to, bottom, 0.06]);
  put([middle - bar / 2, bottom, -deep], [middle + bar / 2, top, -0.03]);
  put([from, rail - bar / 2, -deep], [to, rail + bar / 2, -0.03]);
}

/** A ridge around it all, and the ground before it. */
function hills(out, { hills: colour, ridge }) {
  const paint = shown(colour);
  const at = (i) => {
    const a = (2 * Math.PI * i) / HILLS;
    const high = FAR * ridge * (0.55 + 0.25 * Math.sin(3 * a + 1) + 0.15 * Math.sin(7 * a + 2) + 0.1 * Math.sin(11 * a));
    return [[FAR * Math.cos(a), high, FAR * Math.sin(a)], [FAR * Math.cos(a), -FAR, FAR * Math.sin(a)]];
  };
  for (let i = 0; i < HILLS; i++) {
    const [[a, below], [b, under]] = [at(i), at(i + 1)];
    const inward = [-(a[0] + b[0]), 0, -(a[2] + b[2])];
    quad(out, [below, under, b, a], inward, [PLAIN, PLAIN, PLAIN, PLAIN], paint);
  }
}

/** A block in the axes of `at`, lit by a light from the upper left. */
function blockOf(out, at, axes, from, to, colour) {
  for (let k = 0; k < 3; k++) {
    const [i, j] = [(k + 1) % 3, (k + 2) % 3];
    for (const sign of [-1, 1]) {
      const corner = (a, b) => {
        const p = [0, 0, 0];
        [p[k], p[i], p[j]] = [sign > 0 ? to[k] : from[k], a ? to[i] : from[i], b ? to[j] : from[j]];
        return at(...p);
      };
      const normal = axes[k].map((value) => sign * value);
      const lit = Math.max(0.3, 0.75 + 0.4 * normal[1] - 0.22 * normal[0] + 0.12 * normal[2]);
      const paint = shown(colour.map((value) => value * lit));
      quad(out, [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)], normal, [PLAIN, PLAIN, PLAIN, PLAIN], paint);
    }
  }
}

function span(a, b) {
  const d = subtract(b, a);
  const size = Math.hypot(...d);
  return [d.map((value) => value / size), size];
}
