// Forward kinematics: joint rotations to the bones that the shaders blend. Twins: glsplat/skinning/skeleton.py and
// the placement of glsplat/renderer/skin.py. All in doubles; matrices are 3x4, row by row.

/** Where an item stands by default: {translation, rotation [x, y, z, w], scale}. */
export const HERE = Object.freeze({ translation: [0, 0, 0], rotation: [0, 0, 0, 1], scale: 1 });

export class Skeleton {
  #local; // [J, 12] rest frame in the parent's
  #global; // [J, 12] of the last pose
  #inverse; // [J, 12]
  #order; // joints, parents first

  /** `rest`: world from joint in the zero pose, 12 numbers a joint; `inverseBind` likewise; `parents`: -1 is a root. */
  constructor({ names, parents, rest, inverseBind }) {
    [this.names, this.parents, this.count] = [names, parents, parents.length];
    this.#order = parentsFirst(parents);
    this.#local = new Float64Array(12 * this.count);
    for (let j = 0; j < this.count; j++) {
      const own = rest.slice(12 * j, 12 * j + 12);
      const parent = parents[j];
      const frame = parent < 0 ? own : product(inverse(rest.slice(12 * parent, 12 * parent + 12)), own);
      this.#local.set(frame, 12 * j);
    }
    this.#global = new Float64Array(12 * this.count);
    this.#inverse = Float64Array.from(inverseBind);
  }

  /**
   * Skinning matrices [J, 12] of a pose {joints: [4 J] xyzw, root: [3] metres, translations: [3 J] metres or null}.
   * They are kept until the next call.
   */
  bones({ joints, root, translations = null }, out = new Float64Array(12 * this.count)) {
    const [global, local] = [this.#global, new Float64Array(12)];
    for (const j of this.#order) {
      turned(this.#local, 12 * j, joints, 4 * j, local);
      if (translations) for (let i = 0; i < 3; i++) local[4 * i + 3] += translations[3 * j + i];
      const parent = this.parents[j];
      if (parent < 0) {
        for (let i = 0; i < 3; i++) local[4 * i + 3] += root[i];
        global.set(local, 12 * j);
      } else {
        multiply(global, 12 * parent, local, 0, global, 12 * j);
      }
    }
    for (let j = 0; j < this.count; j++) multiply(global, 12 * j, this.#inverse, 12 * j, out, 12 * j);
    return out;
  }

  /** Where a joint is in a pose: [x, y, z], metres. */
  placeOf(pose, joint) {
    this.bones(pose);
    return [3, 7, 11].map((i) => this.#global[12 * joint + i]);
  }
}

/** The unit quaternion [x, y, z, w] of a rotation vector (radians) at `at`, into `out` at `to`. */
export function quaternionOf(vector, at, out, to) {
  const [x, y, z] = [vector[at], vector[at + 1], vector[at + 2]];
  const angle = Math.hypot(x, y, z);
  const k = angle > 1e-9 ? Math.sin(angle / 2) / angle : 0.5;
  [out[to], out[to + 1], out[to + 2], out[to + 3]] = [k * x, k * y, k * z, Math.cos(angle / 2)];
}

/** The rotation of a quaternion [x, y, z, w] of any length, row by row. */
export function matrixOf([x, y, z, w]) {
  const s = 2 / (x * x + y * y + z * z + w * w || 1);
  return [
    1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w),
    s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w),
    s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y),
  ];
}

/** Bones [J, 12] from the item's own space to where it stands; its scale stays out of them (skin.vert.glsl: size). */
export function placed(bones, { translation, rotation, scale }, out = new Float64Array(bones.length)) {
  const r = matrixOf(rotation);
  const offset = translation.map((v) => v / scale);
  const place = [r[0], r[1], r[2], offset[0], r[3], r[4], r[5], offset[1], r[6], r[7], r[8], offset[2]];
  for (let at = 0; at < bones.length; at += 12) multiply(place, 0, bones, at, out, at);
  return out;
}

/** Whether every bone turns and moves and does nothing else, within 1e-4. */
export function rigid(bones) {
  for (let at = 0; at < bones.length; at += 12) {
    for (let i = 0; i < 3; i++) {
      for (let k = i; k < 3; k++) {
        let dot = 0;
        for (let row = 0; row < 3; row++) dot += bones[at + 4 * row + i] * bones[at + 4 * row + k];
        if (!(Math.abs(dot - (i === k ? 1 : 0)) < 1e-4)) return false;
      }
    }
    if (!(determinant(bones, at) > 0)) return false;
  }
  return true;
}

/** Joints in an order in which parents come first. Throws where there is none. */
function parentsFirst(parents) {
  const depth = new Int32Array(parents.length);
  for (let j = 0; j < parents.length; j++) {
    for (let k = parents[j]; k >= 0; k = parents[k]) {
      if (++depth[j] > parents.length) throw new Error('the joints of the skeleton form a cycle');
    }
  }
  return Array.from(depth.keys()).sort((a, b) => depth[a] - depth[b]);
}

/** out = the 3x4 at `at`, its rotation turned by the quaternion at `from`. */
function turned(m, at, quaternions, from, out) {
  const r = matrixOf([quaternions[from], quaternions[from + 1], quaternions[from + 2], quaternions[from + 3]]);
  for (let i = 0; i < 3; i++) {
    const [a, b, c] = [m[at + 4 * i], m[at + 4 * i + 1], m[at + 4 * i + 2]];
    for (let k = 0; k < 3; k++) out[4 * i + k] = a * r[k] + b * r[3 + k] + c * r[6 + k];
    out[4 * i + 3] = m[at + 4 * i + 3];
  }
}

function multiply(a, i, b, k, out, to) {
  const [b0, b1, b2, b3, b4, b5, b6, b7, b8, b9, b10, b11] = b.slice(k, k + 12);
  for (let row = 0; row < 12; row += 4) {
    const [x, y, z, w] = [a[i + row], a[i + row + 1], a[i + row + 2], a[i + row + 3]];
    out[to + row] = x * b0 + y * b4 + z * b8;
    out[to + row + 1] = x * b1 + y * b5 + z * b9;
    out[to + row + 2] = x * b2 + y * b6 + z * b10;
    out[to + row + 3] = x * b3 + y * b7 + z * b11 + w;
  }
}

function product(a, b) {
  const out = new Array(12);
  multiply(a, 0, b, 0, out, 0);
  return out;
}

function determinant(m, at) {
  const [a, b, c, d, e, f, g, h, i] = [0, 1, 2, 4, 5, 6, 8, 9, 10].map((k) => m[at + k]);
  return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
}

/** The inverse of any 3x4 with a 3x3 that has one. */
function inverse(m) {
  const [a, b, c, x, d, e, f, y, g, h, i, z] = m;
  const k = 1 / determinant(m, 0);
  if (!Number.isFinite(k)) throw new Error('the matrix of a joint is not invertible');
  const r = [
    k * (e * i - f * h), k * (c * h - b * i), k * (b * f - c * e),
    k * (f * g - d * i), k * (a * i - c * g), k * (c * d - a * f),
    k * (d * h - e * g), k * (b * g - a * h), k * (a * e - b * d),
  ];
  const moved = [0, 3, 6].map((row) => -(r[row] * x + r[row + 1] * y + r[row + 2] * z));
  return [r[0], r[1], r[2], moved[0], r[3], r[4], r[5], moved[1], r[6], r[7], r[8], moved[2]];
}

// Expressions on the CPU, for the order of splats, which the shader moves itself. Twin: glsplat/skinning/shapes.py.
const BEND = 3 / 127; // of an axis, a unit of a shape's bends

/**
 * What the GPU reads at `weights` [T]: metres a unit of moves and axis a unit of bends, [2 T]; null where all are 0.
 * `limits`: [2 T], least and largest weight.
 */
export function amountsOf({ sizes, limits }, weights) {
  const out = new Float32Array(2 * sizes.length);
  let any = false;
  for (let k = 0; k < sizes.length; k++) {
    const w = Math.min(Math.max(weights[k] || 0, limits[2 * k]), limits[2 * k + 1]);
    any ||= w !== 0;
    [out[2 * k], out[2 * k + 1]] = [w * sizes[k], w * BEND];
  }
  return any ? out : null;
}

/** The means [3 N] of splats at those amounts, into `out`. */
export function movedMeans({ means, count, shapes: { starts, texels } }, amounts, out) {
  out.set(means);
  for (let i = 0; i < count; i++) {
    for (let e = starts[i]; e < starts[i + 1]; e++) {
      const by = amounts[2 * (texels[4 * e + 3] & 255)];
      if (by === 0) continue;
      const [first, second] = [texels[4 * e], texels[4 * e + 1]];
      out[3 * i] += by * ((first << 16) >> 16);
      out[3 * i + 1] += by * (first >> 16);
      out[3 * i + 2] += by * ((second << 16) >> 16);
    }
  }
  return out;
}
