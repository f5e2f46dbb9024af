// Frusta as tangents {left, right, down, up}: x / -z and y / -z at the picture's borders, in an eye's own frame.

import { add, apply, invert, scale, subtract } from './matrix.js';

const NEAR = 0.05; // metres; what is nearer to the eye's plane, or behind it, has no tangent
const WIDEST = 8; // a tangent; 83 degrees off the axis

/** The tangents of a WebXR or OpenGL projection matrix, off-centre ones included. */
export function tangentsOf(p) {
  return {
    left: (p[8] - 1) / p[0],
    right: (p[8] + 1) / p[0],
    down: (p[9] - 1) / p[5],
    up: (p[9] + 1) / p[5],
  };
}

/** The frustum widened by an angle (radians) on every side. */
export function widened({ left, right, down, up }, angle) {
  const out = (t, by) => clamp(Math.tan(Math.min(1.45, Math.max(-1.45, Math.atan(t) + by))));
  return { left: out(left, -angle), right: out(right, angle), down: out(down, -angle), up: out(up, angle) };
}

/** What two frusta share; null if nothing, or less than a hundredth. */
export function intersection(a, b) {
  const out = {
    left: Math.max(a.left, b.left),
    right: Math.min(a.right, b.right),
    down: Math.max(a.down, b.down),
    up: Math.min(a.up, b.up),
  };
  return out.right - out.left > 0.01 && out.up - out.down > 0.01 ? out : null;
}

/** The smallest frustum that holds all of these, of which some may be null; null of none. */
export function joined(frusta) {
  const there = frusta.filter((frustum) => frustum !== null);
  if (!there.length) return null;
  const all = (name) => there.map((frustum) => frustum[name]);
  return { left: Math.min(...all('left')), right: Math.max(...all('right')), down: Math.min(...all('down')), up: Math.max(...all('up')) };
}

/** The eight corners of [x0, y0, z0, x1, y1, z1]. */
export function corners([x0, y0, z0, x1, y1, z1]) {
  return [0, 1, 2, 3, 4, 5, 6, 7].map((i) => [i & 1 ? x1 : x0, i & 2 ? y1 : y0, i & 4 ? z1 : z0]);
}

/** The smallest frustum of the eye at `transform` that holds a box given by its eight corners (in `corners` order). */
export function around(points, transform) {
  const view = invert(transform);
  const seen = points.map((point) => apply(view, point).slice(0, 3));
  return boundsOf(clippedEdges(seen));
}

/** Likewise of a flat four-cornered thing, given in order around it. */
export function aroundQuad(points, transform) {
  const view = invert(transform);
  const seen = points.map((point) => apply(view, point).slice(0, 3));
  return boundsOf(seen.flatMap((point, i) => clipped(point, seen[(i + 1) % seen.length])));
}

/** Whether an upright flat four-cornered thing is straight ahead of the eye at `transform`. */
export function isAhead(points, transform) {
  const { left, right } = aroundQuad(points, transform) ?? { left: 0, right: 0 };
  return left < 0 && right > 0;
}

/** [fx, fy, cx, cy] in pixels of a frustum that fills a picture of [width, height]. */
export function intrinsics({ left, right, down, up }, [width, height]) {
  const fx = width / (right - left);
  const fy = height / (up - down);
  return [fx, fy, -left * fx, up * fy];
}

const EDGES = [];
for (let i = 0; i < 8; i++) for (const bit of [1, 2, 4]) if (!(i & bit)) EDGES.push([i, i | bit]);

function clippedEdges(points) {
  return EDGES.flatMap(([a, b]) => clipped(points[a], points[b]));
}

/** The ends of the part of an edge that lies in front of the eye: two points or none. */
function clipped(a, b) {
  const [da, db] = [-a[2] - NEAR, -b[2] - NEAR];
  if (da < 0 && db < 0) return [];
  if (da >= 0 && db >= 0) return [a, b];
  const cut = add(a, scale(subtract(b, a), da / (da - db)));
  return da >= 0 ? [a, cut] : [cut, b];
}

function boundsOf(points) {
  if (!points.length) return null;
  const xs = points.map((p) => clamp(p[0] / -p[2]));
  const ys = points.map((p) => clamp(p[1] / -p[2]));
  return { left: Math.min(...xs), right: Math.max(...xs), down: Math.min(...ys), up: Math.max(...ys) };
}

const clamp = (t) => Math.min(WIDEST, Math.max(-WIDEST, t));
