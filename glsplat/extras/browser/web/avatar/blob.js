// Reads an avatar's file (docs/protocol.md, section 8.1). Every count is checked against the bytes before anything is
// allocated; a BlobError of one sentence says what is wrong. Twin: glsplat/extras/browser/web_format/read.py.

import { Skeleton } from '../draw/bones.js';

/** Limits of a file. */
const MOST = { joints: 4096, splats: 1 << 21, entries: 1 << 24, parts: 64, shapes: 256, name: 64, bytes: 256 << 20 };

const FAR = 1e6; // largest number: metres, sizes or colours
const ABSENT = { splats: 0, entries: 0, density: null, sh: [], shaded: false };
const LOGS = 60; // natural logarithms of sizes

/** An invalid avatar's file; the message is one sentence. */
export class BlobError extends Error {
  name = 'BlobError';
}

function fail(words) {
  throw new BlobError(words);
}

/** Return the header with the defaults of its parts filled in. Throws BlobError unless it is valid. */
function checkHeader(header) {
  const whole = (value, least, most) => Number.isInteger(value) && value >= least && value <= most;
  const numbers = (value, size, most = FAR) =>
    Array.isArray(value) && value.length === size && value.every((v) => typeof v === 'number' && Math.abs(v) <= most);
  const text = (value) => typeof value === 'string' && value.length <= MOST.name;
  const check = (right, words) => right || fail(`the header of this avatar has ${words}`);

  check(isObject(header), 'no object');
  check(whole(header.sh_degree, 0, 3), 'an sh_degree that is not 0 to 3');
  check([1, 2, 4, 8].includes(header.influences), 'influences that are not 1, 2, 4 or 8');
  check(typeof header.antialias === 'boolean', 'an antialias that is not true or false');
  const { joints, shapes, parts } = header;
  const count = joints?.parents?.length;
  check(isObject(joints) && whole(count, 1, MOST.joints) && Array.isArray(joints.parents), `no joints, or more than ${MOST.joints}`);
  check(Array.isArray(joints.names) && joints.names.length === count && joints.names.every(text), 'joints without names');
  check(joints.parents.every((parent) => whole(parent, -1, count - 1)), 'a joint with an unknown parent');
  check(numbers(joints.rest, 12 * count) && numbers(joints.inverse_bind, 12 * count), 'joints without 12 finite numbers each');
  if (shapes !== null) {
    const size = shapes?.names?.length;
    check(isObject(shapes) && whole(size, 1, MOST.shapes), `no shapes, or more than ${MOST.shapes}`);
    check(Array.isArray(shapes.names) && shapes.names.every(text), 'shapes without names');
    check(numbers(shapes.sizes, size) && numbers(shapes.limits, 2 * size), 'shapes without sizes and limits');
    const holds = shapes.names.every((_, k) => shapes.limits[2 * k] <= 0 && shapes.limits[2 * k + 1] >= 0);
    check(holds, 'limits of a shape that do not include 0');
  }
  check(Array.isArray(parts) && whole(parts.length, 1, MOST.parts), `no parts, or more than ${MOST.parts}`);
  let end = 0; // end of the last part, bytes after the header
  const levels = new Map();
  for (const part of parts) {
    check(isObject(part) && whole(part.level, 0, MOST.parts), 'a part without a level');
    for (const [name, value] of Object.entries(ABSENT)) part[name] ??= value;
    check(part.offset === end && whole(part.bytes, 1, MOST.bytes), 'a part that does not follow the previous one');
    end += part.bytes;
    check(end <= MOST.bytes, `more than ${MOST.bytes >> 20} MiB of parts`);
    if (part.kind === 'splats') {
      check(whole(part.splats, 1, MOST.splats), `a part without splats, or with more than ${MOST.splats}`);
      check(!levels.has(part.level), 'two parts of one level');
      check(numbers(part.low, 3) && numbers(part.high, 3), 'splats without a box');
      check(numbers(part.scales, 2, LOGS) && numbers(part.colours, 6), 'splats without scales and colours');
      check(numbers(part.sh, header.sh_degree), 'splats without a scale of each SH degree');
      check(part.level === 0 || (typeof part.density === 'number' && part.density >= 0), 'a level without its density');
      levels.set(part.level, part.splats);
    } else if (part.kind === 'surface') {
      check(levels.has(part.level), 'a surface without splats');
      check(typeof part.shaded === 'boolean', 'a shaded that is not true or false');
    } else {
      check(part.kind === 'shapes' && shapes !== null && levels.has(part.level), 'a part that is neither splats nor their shapes nor their surface');
      check(whole(part.entries, 0, MOST.entries), 'too many entries of shapes');
    }
  }
  check(levels.has(0), 'no finest level');
  return header;
}

function isObject(value) {
  return value !== null && typeof value === 'object' && !Array.isArray(value);
}

const START = 16; // bytes before the header
const STEPS = 4095; // of a weight
const HEADER = 1 << 20; // bytes of it at most, unpacked

/** Return {end, unpacked} of the header in bytes; null while its beginning has not arrived. */
export function headOf(bytes) {
  if (bytes.length < START) return null;
  const view = new DataView(bytes.buffer, bytes.byteOffset, START);
  if (view.getUint32(0) !== 0x47534156) fail('not an avatar: it does not begin with GSAV');
  if (view.getUint16(4, true) !== 1) fail(`this avatar has version ${view.getUint16(4, true)}; this page reads version 1`);
  const [packed, unpacked] = [view.getUint32(8, true), view.getUint32(12, true)];
  if (unpacked > HEADER || packed > HEADER) fail('the header of this avatar is larger than 1 MiB');
  return { end: START + packed, unpacked };
}

/**
 * Return {header, skeleton, start (of the parts)} of a file of which at least `headOf(bytes).end` bytes have arrived.
 */
export async function openBlob(bytes) {
  const found = headOf(bytes);
  if (!found || bytes.length < found.end) fail('this avatar ends before its header does');
  const text = new TextDecoder().decode(await inflated(bytes.subarray(START, found.end), found.unpacked, 'header'));
  let header;
  try {
    header = JSON.parse(text);
  } catch {
    fail('the header of this avatar is not JSON');
  }
  const { joints } = checkHeader(header);
  let skeleton;
  try {
    const { names, parents, rest, inverse_bind: inverseBind } = joints;
    skeleton = new Skeleton({ names, parents, rest, inverseBind });
  } catch (error) {
    fail(error.message);
  }
  return { header, skeleton, start: found.end };
}

/** Return the splats of a part of the kind "splats", as drawing.js takes them, from its packed bytes. */
export async function splatsOf(header, part, bytes) {
  const { sh_degree: degree, influences, antialias, joints } = header;
  const [count, wide] = [part.splats, joints.parents.length > 256];
  const planes = 17 + 3 * ((degree + 1) ** 2 - 1) + influences * (wide ? 2 : 1) + 2 * (influences - 1);
  const data = await inflated(bytes, planes * count, 'splats');
  let at = 0;
  const plane = () => data.subarray(at, (at += count));
  const means = meansOf([0, 1, 2].map(() => [plane(), plane()]), part, count);
  const quats = quatsOf([plane(), plane(), plane(), plane()], count);
  const scales = new Float32Array(3 * count);
  const [low, high] = part.scales;
  const sizes = Float64Array.from({ length: 256 }, (_, q) => (q === 0 ? 0 : Math.exp(low + ((high - low) * (q - 1)) / 254)));
  for (let axis = 0; axis < 3; axis++) {
    const from = plane();
    for (let i = 0; i < count; i++) scales[3 * i + axis] = sizes[from[i]];
  }
  const opacities = Float32Array.from(plane(), (q) => q / 255);
  const coefficients = 3 * (degree + 1) ** 2;
  const sh = new Float32Array(coefficients * count);
  for (let c = 0; c < 3; c++) {
    const [from, lo, hi] = [plane(), part.colours[c], part.colours[3 + c]];
    for (let i = 0, q = 0; i < count; i++) sh[coefficients * i + c] = lo + ((hi - lo) * (q = (q + from[i]) & 255)) / 255;
  }
  for (let k = 3; k < coefficients; k++) {
    const [from, step] = [plane(), part.sh[Math.floor(Math.sqrt(Math.floor(k / 3))) - 1] / 127];
    for (let i = 0; i < count; i++) sh[coefficients * i + k] = ((from[i] << 24) >> 24) * step;
  }
  const which = new Uint16Array(influences * count);
  for (let k = 0; k < influences; k++) {
    const [from, more] = [plane(), wide ? plane() : null];
    for (let i = 0; i < count; i++) {
      const joint = from[i] | (more ? more[i] << 8 : 0);
      if (joint >= joints.parents.length) fail(`this avatar's skin names joint ${joint} of ${joints.parents.length}`);
      which[influences * i + k] = joint;
    }
  }
  const weights = new Float32Array(influences * count);
  const left = new Int32Array(count).fill(STEPS); // weight of the first slot: the rest of the others
  for (let k = 1; k < influences; k++) {
    const [lower, upper] = [plane(), plane()];
    for (let i = 0; i < count; i++) {
      const steps = lower[i] | (upper[i] << 8);
      weights[influences * i + k] = steps / STEPS;
      left[i] -= steps;
    }
  }
  for (let i = 0; i < count; i++) {
    if (left[i] < 0) fail("the weights of this avatar's splats sum to more than 1");
    weights[influences * i] = left[i] / STEPS;
  }
  return { count, means, quats, scales, opacities, sh, degree, antialias, joints: which, weights, influences, shapes: null, surface: null };
}

/** Return the shapes of `count` splats from a part of the kind "shapes": {names, sizes, limits, starts, texels}. */
export async function shapesOf(header, part, count, bytes) {
  const { names, sizes, limits } = header.shapes;
  const { entries } = part;
  const data = await inflated(bytes, 2 * count + 13 * entries, 'shapes');
  const starts = new Uint32Array(count + 1);
  for (let i = 0; i < count; i++) starts[i + 1] = starts[i] + (data[i] | (data[count + i] << 8));
  if (starts[count] !== entries) fail(`this avatar's shapes state ${entries} entries and have ${starts[count]}`);
  const texels = new Uint32Array(4 * entries);
  const bytesOf = new Uint8Array(texels.buffer);
  const plane = (k) => 2 * count + k * entries;
  for (let e = 0; e < entries; e++) {
    const target = data[plane(0) + e];
    if (target >= names.length) fail(`this avatar's shapes name shape ${target} of ${names.length}`);
    for (let k = 0; k < 12; k++) bytesOf[16 * e + k] = data[plane(1 + k) + e];
    bytesOf[16 * e + 12] = target;
  }
  return { names, sizes, limits, starts, texels };
}

/**
 * Return the surface (glsplat/light/surface.py) of `count` splats: {normals [3 N], occlusion [N], shade [3 N] or null}.
 */
export async function surfaceOf(part, count, bytes) {
  const data = await inflated(bytes, (part.shaded ? 7 : 4) * count, 'surface');
  const rows = (from, width) => {
    const out = new Uint8Array(width * count);
    for (let k = 0; k < width; k++) {
      const plane = data.subarray((from + k) * count, (from + k + 1) * count);
      for (let i = 0, q = 0; i < count; i++) out[width * i + k] = q = (q + plane[i]) & 255;
    }
    return out;
  };
  return { normals: new Int8Array(rows(0, 3).buffer), occlusion: rows(3, 1), shade: part.shaded ? rows(4, 3) : null };
}

/** Unpack exactly `size` bytes. Throws BlobError for more or fewer; stops unpacking beyond them. */
async function inflated(bytes, size, what) {
  const out = new Uint8Array(size);
  const unpacked = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate-raw'));
  const reader = unpacked.getReader();
  let at = 0;
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      if (at + value.length > size) fail(`the ${what} of this avatar unpack to more than the stated ${size} bytes`);
      out.set(value, at);
      at += value.length;
    }
  } catch (error) {
    reader.cancel().catch(() => {});
    if (error?.name === 'BlobError') throw error;
    fail(`the ${what} of this avatar cannot be unpacked`);
  }
  if (at !== size) fail(`the ${what} of this avatar unpack to ${at} bytes instead of ${size}`);
  return out;
}

function meansOf(planes, { low, high }, count) {
  const means = new Float32Array(3 * count);
  planes.forEach(([lower, upper], axis) => {
    const unit = (high[axis] - low[axis]) / 65535;
    for (let i = 0, q = 0; i < count; i++) {
      const z = lower[i] | (upper[i] << 8);
      q = (q + ((z >> 1) ^ -(z & 1))) & 0xffff;
      means[3 * i + axis] = low[axis] + unit * q;
    }
  });
  return means;
}

function quatsOf([b0, b1, b2, b3], count) {
  const quats = new Float32Array(4 * count);
  for (let i = 0; i < count; i++) {
    const packed = (b0[i] | (b1[i] << 8) | (b2[i] << 16) | (b3[i] << 24)) >>> 0;
    const left = packed >>> 30;
    let rest = 1;
    for (let k = 0, from = packed; k < 4; k++) {
      if (k === left) continue;
      const v = (((from & 1023) / 1023) * 2 - 1) * Math.SQRT1_2;
      quats[4 * i + k] = v;
      rest -= v * v;
      from >>>= 10;
    }
    quats[4 * i + left] = Math.sqrt(Math.max(0, rest));
    const size = Math.hypot(quats[4 * i], quats[4 * i + 1], quats[4 * i + 2], quats[4 * i + 3]);
    for (let k = 0; k < 4; k++) quats[4 * i + k] /= size;
  }
  return quats;
}
