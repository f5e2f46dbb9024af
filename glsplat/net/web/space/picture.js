// Where a picture lies in the room: how far away each point of it is, on a grid, and what a mirror's glass lets through.

import { add, apply, cross, dot, invert, place, scale, subtract, unit } from './matrix.js';

const GRAZING = 0.1; // cosine; a plane seen at a flatter angle is put straight before the eye instead
const NEAREST = 0.3; // metres to one that is

/**
 * A plane as a grid of 2 x 2 points over the picture of `camera` ({transform, frustum}): {columns, rows, inverse}, as
 * replies have them. Inverse depth of a plane is linear in the picture, so its corners are exact.
 */
export function planeGrid({ transform, frustum: f }, { point, normal }) {
  const ends = [[f.left, f.up], [f.right, f.up], [f.left, f.down], [f.right, f.down]];
  const rays = ends.map(([x, y]) => apply(transform, [x, y, -1, 0]).slice(0, 3)); // as long as -z is 1
  const reach = dot(subtract(point, place(transform)), normal);
  const steep = rays.every((ray) => dot(unit(ray), normal) < -GRAZING);
  const straight = 1 / Math.max(NEAREST, Math.abs(reach));
  return { columns: 2, rows: 2, inverse: Float32Array.from(rays, (ray) => (steep ? dot(ray, normal) / reach : straight)) };
}

/** Of a camera's picture, in tangents: [left, up, width, height]. */
export const extent = ({ frustum: f }) => [f.left, f.up, f.right - f.left, f.up - f.down];

/**
 * The planes through an eye at `transform` and the edges of a `glass` (4 corners around it), four columns of a matrix
 * in the axes of `camera`: what is seen through the glass has no product below 0 with any of them. Nothing where there
 * is no glass.
 */
export function cuts(glass, camera, transform) {
  if (!glass) return new Array(16).fill(0);
  const eye = place(transform);
  const middle = scale(glass.reduce(add, [0, 0, 0]), 1 / glass.length);
  const back = invert(camera.transform);
  return glass.flatMap((corner, i) => {
    const edge = cross(subtract(corner, eye), subtract(glass[(i + 1) % glass.length], eye));
    const normal = scale(edge, dot(subtract(middle, eye), edge) < 0 ? -1 : 1);
    return [...apply(back, [...normal, 0]).slice(0, 3), dot(normal, subtract(place(camera.transform), eye))];
  });
}
