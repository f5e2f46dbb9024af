// Chooses levels of detail. Twin: glsplat/renderer/levels.py, which has units and reasons.

const MOVED = 96; // points that stand for an avatar
const STILL = 256; // for splats without a skeleton
const LOOKED_AT = 65536; // splats sampled to place the points
const RIM = 0.25; // of a cosine, over which points fade beyond the corners of the picture
const BAND = 1.05; // hysteresis

/**
 * Return the coarsest level that is sharp enough at `wanted` pixels per metre; 0 is the finest. `densities`: of the
 * coarser levels, falling; `before`: the last level of the same view.
 */
export function chosen(densities, wanted, before = undefined) {
  const suffices = (least) => densities.filter((density) => density >= least).length;
  const level = suffices(wanted);
  if (before === undefined || level === before) return level;
  return level > before ? Math.max(before, suffices(wanted * BAND)) : Math.min(before, suffices(wanted / BAND));
}

/** Return a few points that represent splats: [{point, spread (m), area (m^2), joint}]. */
export function proxyOf({ count, means, scales, opacities, joints, influences }) {
  const step = Math.max(1, Math.ceil(count / LOOKED_AT));
  const byJoint = new Map();
  let total = 0;
  for (let i = 0; i < count; i += step, total++) {
    const joint = joints ? joints[influences * i] : 0;
    if (!byJoint.has(joint)) byJoint.set(joint, []);
    byJoint.get(joint).push(i);
  }
  const most = joints ? MOVED : STILL;
  const points = [];
  for (const joint of [...byJoint.keys()].sort((a, b) => a - b)) {
    const mine = byJoint.get(joint);
    const share = Math.min(Math.max(1, Math.floor((most * mine.length) / total)), mine.length);
    for (const cell of cells(means, mine, share)) points.push({ ...pointOf(cell, { means, scales, opacities }, count / total), joint });
  }
  return points;
}

/**
 * Return the pixels per metre at which a camera (frame.js) shows points under `bones` [J, 12] of an item at `place`; 0:
 * unseen.
 */
export function densityOf(points, { rows, intrinsics: [fx, fy, cx, cy], width, height }, bones, { scale }) {
  const [right, down] = [Math.max(cx, width - cx) / fx, Math.max(cy, height - cy) / fy];
  const corner = 1 / Math.sqrt(1 + right * right + down * down);
  let [pixels, squares] = [0, 0];
  for (const { point: [x, y, z], spread, area, joint } of points) {
    const b = bones ? 12 * joint : -1;
    const at = b < 0 ? [x, y, z] : [0, 4, 8].map((r) => bones[b + r] * x + bones[b + r + 1] * y + bones[b + r + 2] * z + bones[b + r + 3]);
    const seen = [0, 4, 8].map((r) => rows[r] * at[0] + rows[r + 1] * at[1] + rows[r + 2] * at[2] + rows[r + 3] / scale);
    const variance = spread * spread;
    const cosine = (seen[2] + spread) / Math.sqrt(seen[0] ** 2 + seen[1] ** 2 + seen[2] ** 2 + variance);
    const near = 1 / (seen[2] ** 2 + variance);
    const own = Math.min(Math.max((cosine - corner) / RIM + 1, 0), 1) * area * near;
    pixels += own;
    squares += own * near;
  }
  return pixels > 0 ? Math.max(fx, fy) * Math.sqrt(squares / pixels) : 0;
}

function pointOf(cell, { means, scales, opacities }, weight) {
  const point = [0, 0, 0];
  for (const i of cell) for (let k = 0; k < 3; k++) point[k] += means[3 * i + k] / cell.length;
  let [apart, area] = [0, 0];
  for (const i of cell) {
    const [thin, mid, long] = [0, 1, 2].map((k) => Math.abs(scales[3 * i + k])).sort((a, b) => a - b);
    for (let k = 0; k < 3; k++) apart += (means[3 * i + k] - point[k]) ** 2;
    apart += thin * thin + mid * mid + long * long;
    area += 2 * Math.PI * mid * long * Math.min(opacities[i], 1) * weight;
  }
  return { point, spread: Math.max(Math.sqrt(apart / cell.length), 1e-9), area };
}

/** Round half to even, as Python does. */
function rounded(value) {
  const whole = Math.floor(value);
  return value - whole === 0.5 ? whole + (whole % 2) : Math.round(value);
}

/** Split indices into `count` cells by halving along the longest axis. */
function cells(means, index, count) {
  if (count === 1) return [index];
  const span = (axis) => {
    let [low, high] = [Infinity, -Infinity];
    for (const i of index) [low, high] = [Math.min(low, means[3 * i + axis]), Math.max(high, means[3 * i + axis])];
    return high - low;
  };
  const spans = [0, 1, 2].map(span);
  const axis = spans.indexOf(Math.max(...spans));
  const left = count >> 1;
  const cut = Math.min(Math.max(rounded((index.length * left) / count), left), index.length - (count - left));
  const order = [...index].sort((a, b) => means[3 * a + axis] - means[3 * b + axis]);
  return [...cells(means, order.slice(0, cut), left), ...cells(means, order.slice(cut), count - left)];
}
