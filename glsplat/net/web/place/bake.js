// What a place looks like, worked out once into two small textures: its faces in the light of windows, lamps and the sun,
// darker in the corners, as a display shows them; and the grain of its floor. A headset only looks them up.

import { cross, dot, subtract, unit } from '../space/matrix.js';

/** Texels of the picture, and where in it each face lies: [x, y, width, height]. */
export const ATLAS = { width: 128, height: 256 };
export const FACES = {
  floor: [0, 0, 128, 128],
  ceiling: [0, 128, 64, 64],
  walls: [
    [64, 128, 64, 32], // -x
    [64, 160, 64, 32], // +x
    [0, 192, 64, 32], // -z
    [64, 192, 64, 32], // +z
  ],
};
/** Texels of a side of the floor's grain, which is repeated. */
export const GRAIN = 256;

const SAMPLES = 4; // a side of a window
const SUNS = 16; // points of a sun that is none: a disc
const DISC = 0.05; // its radius, of a unit's length: penumbras are wider than texels, or a patch of sun had teeth
const GOLDEN = Math.PI * (3 - Math.sqrt(5));
const RIM = 0.2; // metres, more than a texel, by which a bright window is smaller than its hole: the wall has no halo
const BOUNCE = 0.16; // of what falls in, as light from everywhere

/** RGBA bytes of the atlas for one of LOOKS. */
export function bake(look) {
  const rows = baking(look);
  for (;;) {
    const { done, value } = rows.next();
    if (done) return value;
  }
}

/** The same, a row of texels at a time: who shows pictures meanwhile does other things between two of them. */
export function* baking(look) {
  const bytes = new Uint8Array(4 * ATLAS.width * ATLAS.height).fill(255);
  const horizon = shown(look.sky.horizon);
  const falls = lightIn(look);
  for (const [rect, at] of faces(look)) {
    const [left, top, width, height] = rect;
    for (let y = 0; y < height; y++) {
      yield;
      for (let x = 0; x < width; x++) {
        // the outer texels lie on the edges: linear filtering never reads a neighbour face
        const { point, normal } = at((x + 0.5) / width, (y + 0.5) / height);
        const sunny = look.sun && dot(normal, look.sun.towards) > -DISC;
        const spots = sunny ? SPOTS.map(([a, b]) => at((x + 0.5 + a) / width, (y + 0.5 + b) / height).point) : undefined;
        const light = falls(point, normal, spots);
        const to = 4 * ((top + y) * ATLAS.width + left + x);
        const colour = surface(point, normal, look).map((value, k) => value * light[k]);
        const far = look.fade ? smoothstep(look.fade[0], look.fade[1], Math.hypot(point[0], point[2])) : 0;
        for (let k = 0; k < 3; k++) {
          const value = displayed(colour[k]);
          bytes[to + k] = 255 * (value + far * (horizon[k] - value));
        }
      }
    }
  }
  return bytes;
}

/**
 * What says how much light [r, g, b] falls at a point of a place on a surface with a unit normal: 1 shows it in its colour.
 * The sun's part is the mean of `spots` about the point.
 */
export function lightIn(look) {
  const windows = look.windows.map((one) => panes(one, look));
  const suns = look.sun ? discOf(unit(look.sun.towards)) : [];
  let [where, rays] = [null, []]; // of the sun that come to the point asked for last, often with other normals
  return (point, normal, spots = [point]) => {
    if (point !== where) [where, rays] = [point, suns.filter((ray, i) => comesIn(spots[i % spots.length], ray, look))];
    return lightAt(point, normal, look, windows, rays);
  };
}

/** Bytes of the floor's grain, 128 where it changes nothing, and the metres it covers [x, z]; null: there is none. */
export function grain({ boards }) {
  if (!boards) return null;
  const { across, along, joint, vary } = boards;
  const [columns, rows] = [Math.max(2, Math.round(2.56 / across)), Math.max(2, Math.round(3.2 / along))];
  const metres = [columns * across, rows * along];
  const bytes = new Uint8Array(GRAIN * GRAIN);
  const brick = across !== along; // boards are laid off each other, tiles are not
  for (let y = 0; y < GRAIN; y++) {
    for (let x = 0; x < GRAIN; x++) {
      const [u, column] = split((x / GRAIN) * columns);
      const [v, row] = split(((y / GRAIN) * rows + (brick ? random(column, 7) * rows : 0)) % rows);
      const piece = 1 + vary * (random(column, row) - 0.5);
      const fibre = 1 + 0.25 * vary * (random(x, brick ? 1 + (y >> 4) : y) - 0.5);
      const edge = Math.min(across * Math.min(u, 1 - u), along * Math.min(v, 1 - v)); // metres
      const line = 1 - joint * (1 - smoothstep(0, 0.012, edge));
      bytes[y * GRAIN + x] = Math.min(255, 128 * piece * fibre * line);
    }
  }
  return { bytes, metres };
}

/** Linear light as a display shows it, softly where it is bright. */
export function shown(colour) {
  return colour.map(displayed);
}

/** Where in a texel, in texels from its middle, and a little beyond: what linear filtering makes of it has no steps. */
const SPOTS = Array.from({ length: SUNS }, (_, i) => [0.375 * (i % 4) - 0.5625, 0.375 * (((5 * i) >> 2) & 3) - 0.5625]);

const displayed = (c) => Math.min(1, ((c * (1 + c * 0.18)) / (1 + c * 0.55)) ** (1 / 2.2));

/** The colour of a face at a point; windows are as bright as what is behind them. */
function surface(point, normal, { walls, floor, wall, ceiling, windows, half: [w, , d], sky }) {
  if (normal[1] > 0.5) return floor;
  if (normal[1] < -0.5) return ceiling;
  const side = Math.abs(normal[0]) > 0.5 ? (point[0] < 0 ? 0 : 1) : point[2] < 0 ? 2 : 3;
  const along = point[side < 2 ? 2 : 0];
  const behind = walls && windows.some(([which, from, to, bottom, top]) => which === side && along > from + RIM && along < to - RIM && point[1] > bottom + RIM && point[1] < top - RIM);
  return behind ? sky.horizon.map((value) => 2.4 * value) : wall.map((value) => value * (point[1] < 0.1 ? 0.8 : 1));
}

const split = (value) => [value - Math.floor(value), Math.floor(value)];

/** A number from 0 to 1 of two whole ones, the same each time. */
export function random(a, b) {
  const value = Math.sin(a * 127.1 + b * 311.7) * 43758.5453;
  return value - Math.floor(value);
}

function smoothstep(from, to, value) {
  const t = Math.min(1, Math.max(0, (value - from) / (to - from)));
  return t * t * (3 - 2 * t);
}

function faces({ walls, half: [w, h, d] }) {
  const floor = [FACES.floor, (u, v) => ({ point: [w * (2 * u - 1), 0, d * (2 * v - 1)], normal: [0, 1, 0] })];
  if (!walls) return [floor];
  const ceiling = (u, v) => ({ point: [w * (2 * u - 1), h, d * (2 * v - 1)], normal: [0, -1, 0] });
  const sides = FACES.walls.map((rect, i) => {
    const sign = i % 2 ? 1 : -1;
    const side = (u, v) => (i < 2 ? { point: [sign * w, h * v, d * (2 * u - 1)], normal: [-sign, 0, 0] }
      : { point: [w * (2 * u - 1), h * v, sign * d], normal: [0, 0, -sign] });
    return [rect, side];
  });
  return [floor, [FACES.ceiling, ceiling], ...sides];
}

/** Light [3] at a point of a face, to which `rays` of the sun come. */
function lightAt(point, normal, look, windows, rays) {
  const out = look.ambient.map((v) => v * corners(point, normal, look));
  const [px, py, pz] = point;
  const [nx, ny, nz] = normal;
  for (const { places, area, inward: [ix, iy, iz] } of windows) {
    let sum = 0;
    for (let at = 0; at < places.length; at += 3) {
      const [x, y, z] = [places[at] - px, places[at + 1] - py, places[at + 2] - pz];
      const facing = (x * nx + y * ny + z * nz) * -(x * ix + y * iy + z * iz);
      if (x * nx + y * ny + z * nz <= 0 || facing <= 0) continue;
      const far = x * x + y * y + z * z;
      if (!look.bench || !hidden(px, py, pz, x, y, z, look.bench)) sum += facing / (far * Math.max(far, 0.3) * Math.PI);
    }
    const part = (3 * sum * area) / places.length;
    for (let k = 0; k < 3; k++) out[k] += look.light[k] * (part + BOUNCE * 0.3);
  }
  for (const [x, y, z, ...colour] of look.lamps) {
    const ray = subtract([x, y, z], point);
    const far = dot(ray, ray);
    const part = Math.max(0, dot(ray, normal)) / (Math.sqrt(far) * (0.25 + far));
    for (let k = 0; k < 3; k++) out[k] += part * colour[k];
  }
  if (look.sun) {
    const part = rays.reduce((sum, ray) => sum + Math.max(0, dot(ray, normal)), 0) / SUNS;
    for (let k = 0; k < 3; k++) out[k] += part * look.sun.colour[k];
  }
  return out;
}

/** How much of everywhere a point sees: walls, floor and ceiling near it take their part. */
function corners(point, normal, { walls, half: [w, h, d] }) {
  if (!walls) return 1;
  const near = [w - point[0], w + point[0], d - point[2], d + point[2], point[1], h - point[1]];
  const along = [Math.abs(normal[0]) > 0.5, Math.abs(normal[0]) > 0.5, Math.abs(normal[2]) > 0.5, Math.abs(normal[2]) > 0.5, Math.abs(normal[1]) > 0.5, Math.abs(normal[1]) > 0.5];
  let open = 1;
  near.forEach((far, i) => {
    if (!along[i]) open *= 1 - 0.42 * Math.exp(-Math.max(far, 0) / 0.35);
  });
  return open;
}

/** Unit vectors to a disc about a direction, evenly over it, on a spiral. */
function discOf(middle) {
  const across = unit(cross(middle, [0, 1, 0]));
  const up = cross(across, middle);
  return Array.from({ length: SUNS }, (_, i) => {
    const [radius, a] = [DISC * Math.sqrt((i + 0.5) / SUNS), GOLDEN * i];
    return unit(middle.map((v, k) => v + radius * (Math.cos(a) * across[k] + Math.sin(a) * up[k])));
  });
}

/** Whether the sun in the direction of a ray is seen from a point: by a window, past the block. */
function comesIn(point, ray, look) {
  if (!look.windows.some((pane) => through(point, ray, pane, look))) return false;
  const [x, y, z] = ray.map((v) => 20 * v);
  return !look.bench || !hidden(point[0], point[1], point[2], x, y, z, look.bench);
}

/** Whether a ray leaves by a window. */
function through(point, ray, [wall, from, to, bottom, top], { half: [w, , d] }) {
  const axis = wall < 2 ? 0 : 2;
  const plane = (wall % 2 ? 1 : -1) * (axis ? d : w);
  const t = (plane - point[axis]) / ray[axis];
  if (!(t > 1e-6)) return false;
  const along = point[2 - axis] + t * ray[2 - axis];
  const up = point[1] + t * ray[1];
  return along > from && along < to && up > bottom && up < top;
}

/** Whether a block stands between a point and the end of a ray from it. */
function hidden(px, py, pz, x, y, z, { from, to }) {
  const [ax, bx] = [(from[0] - px) / x, (to[0] - px) / x];
  const [ay, by] = [(from[1] - py) / y, (to[1] - py) / y];
  const [az, bz] = [(from[2] - pz) / z, (to[2] - pz) / z];
  const enters = Math.max(1e-3, Math.min(ax, bx), Math.min(ay, by), Math.min(az, bz));
  return enters < Math.min(1, Math.max(ax, bx), Math.max(ay, by), Math.max(az, bz));
}

/** A window as points that shine: {places: x, y, z a point, area, inward: unit}. */
function panes([wall, from, to, bottom, top], { half: [w, , d] }) {
  const sign = wall % 2 ? 1 : -1;
  const places = [];
  for (let i = 0; i < SAMPLES; i++) {
    for (let k = 0; k < SAMPLES; k++) {
      const along = from + ((to - from) * (i + 0.5)) / SAMPLES;
      const up = bottom + ((top - bottom) * (k + 0.5)) / SAMPLES;
      places.push(...(wall < 2 ? [sign * w, up, along] : [along, up, sign * d]));
    }
  }
  return { places, area: (to - from) * (top - bottom), inward: wall < 2 ? [-sign, 0, 0] : [0, 0, -sign] };
}
