// The value classes of the WebXR Device API, for the fake device in fake_xr.js. Written after the specification's text:
// read-only attributes, one matrix array an object, and the errors it names. Loaded before the page, in one function.
'use strict';

const JOINTS = ['wrist', ...['thumb', 'index-finger', 'middle-finger', 'ring-finger', 'pinky-finger'].flatMap((finger) =>
  ['metacarpal', 'phalanx-proximal', 'phalanx-intermediate', 'phalanx-distal', 'tip']
    .filter((part) => finger !== 'thumb' || part !== 'phalanx-intermediate').map((part) => `${finger}-${part}`))];
const INNER = Symbol('what the page cannot see');

function fail(name, text) {
  throw new DOMException(text, name);
}

/** Read-only attributes of an object: a write is silently ignored, in a module it throws. */
function readonly(object, values) {
  for (const [name, value] of Object.entries(values)) {
    Object.defineProperty(object, name, { value, writable: false, enumerable: true, configurable: false });
  }
  return object;
}

/** 4x4 product of column-major arrays, in doubles. */
function product(a, b) {
  const out = new Array(16).fill(0);
  for (let c = 0; c < 4; c++) {
    for (let r = 0; r < 4; r++) {
      for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
    }
  }
  return out;
}

/** Column-major matrix of a position [x, y, z] in metres and a unit quaternion [x, y, z, w]. */
function rigid([px, py, pz], [x, y, z, w]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0,
    2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0,
    2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0,
    px, py, pz, 1,
  ];
}

/** Inverse of a rotation and translation. */
function inverted(m) {
  const out = [m[0], m[4], m[8], 0, m[1], m[5], m[9], 0, m[2], m[6], m[10], 0, 0, 0, 0, 1];
  for (let r = 0; r < 3; r++) out[12 + r] = -(out[r] * m[12] + out[4 + r] * m[13] + out[8 + r] * m[14]);
  return out;
}

/** Unit quaternion [x, y, z, w] of a rotation matrix, the largest component first for accuracy. */
function quaternion(m) {
  const [a, b, c] = [m[0], m[5], m[10]];
  const squares = [1 + a - b - c, 1 - a + b - c, 1 - a - b + c, 1 + a + b + c];
  const at = squares.indexOf(Math.max(...squares));
  const s = 2 * Math.sqrt(squares[at]);
  const [yz, zx, xy] = [(m[6] - m[9]) / s, (m[8] - m[2]) / s, (m[1] - m[4]) / s];
  const [sx, sy, sz] = [(m[1] + m[4]) / s, (m[8] + m[2]) / s, (m[6] + m[9]) / s];
  return [[s / 4, sx, sy, yz], [sx, s / 4, sz, zx], [sy, sz, s / 4, xy], [yz, zx, xy, s / 4]][at];
}

class XRRigidTransform {
  constructor(position = {}, orientation = {}) {
    const { x = 0, y = 0, z = 0, w = 1 } = position;
    const q = { x: 0, y: 0, z: 0, w: 1, ...pick(orientation) };
    if (w !== 1) throw new TypeError('position.w has to be 1');
    if (![x, y, z, q.x, q.y, q.z, q.w].every(Number.isFinite)) throw new TypeError('numbers have to be finite');
    const length = Math.hypot(q.x, q.y, q.z, q.w);
    if (!(length > 0)) fail('InvalidStateError', 'an orientation needs a length');
    const turn = [q.x / length, q.y / length, q.z / length, q.w / length];
    readonly(this, {
      position: new DOMPointReadOnly(x, y, z, 1),
      orientation: new DOMPointReadOnly(...turn),
      matrix: new Float32Array(rigid([x, y, z], turn)),
    });
  }
}

function pick(point) {
  return Object.fromEntries(['x', 'y', 'z', 'w'].filter((k) => point[k] !== undefined).map((k) => [k, point[k]]));
}

/** The matrix of a transform in doubles. */
function exact({ position: p, orientation: q }) {
  return rigid([p.x, p.y, p.z], [q.x, q.y, q.z, q.w]);
}

function transformOf(m) {
  const [x, y, z, w] = quaternion(m);
  return new XRRigidTransform({ x: m[12], y: m[13], z: m[14] }, { x, y, z, w });
}

class XRSpace extends EventTarget {
  /** origin(): column-major matrix in the room (floor, metres), or null while it is not tracked. */
  constructor(session, origin) {
    super();
    this[INNER] = { session, origin };
  }
}

class XRReferenceSpace extends XRSpace {
  onreset = null;

  getOffsetReferenceSpace(offset) {
    const { session, origin } = this[INNER];
    return new XRReferenceSpace(session, () => {
      const base = origin();
      return base && product(base, exact(offset));
    });
  }
}

/** A pose of the API: what a transform has, and ``more``. */
function poseAt(matrix, more = {}) {
  const still = { emulatedPosition: false, linearVelocity: null, angularVelocity: null };
  return readonly({}, { transform: transformOf(matrix), ...still, ...more });
}

/** An event with read-only attributes. */
function happened(type, values) {
  return readonly(new Event(type), values);
}
