// Where a picture lies in the room: the plane it is put on, and the picture coordinates of points there.

import { apply, dot, invert, movePoint, place, scale, subtract, add, unit } from './matrix.js';

const GRAZING = 0.1; // cosine; a plane seen at a flatter angle is put straight before the eye instead

/**
 * Corners for drawing the picture of `camera` ({transform, frustum} as it was asked for) to an eye at `transform` now:
 * {positions: 4 x [x, y, z], texels: 4 x [u w, v w, w]}, in the order of a triangle strip; u, v from 0 at the upper
 * left to 1. Through a `glass` (4 corners around it) the glass is what is drawn, and the plane lies behind it.
 */
export function pictureQuad(camera, { point, normal }, glass, transform) {
  const texel = (h) => texelOf(camera, h);
  if (!glass) {
    const positions = cornersOnPlane(camera, point, normal);
    return { positions, texels: positions.map((p) => texel([...p, 1])) };
  }
  // the ray from the eye through a point of the glass meets the plane at X = E + t (G - E); its homogeneous
  // coordinates are linear in G, so four corners and the rasterizer's own interpolation are exact
  const eye = place(transform);
  const reach = dot(subtract(point, eye), normal);
  const positions = [glass[3], glass[2], glass[0], glass[1]];
  const texels = positions.map((g) => {
    const ray = subtract(g, eye);
    const w = dot(ray, normal);
    const x = add(scale(eye, w), scale(ray, reach));
    return texel([...x, w].map((v) => -v)); // the normal points to the eye: w is negative before it
  });
  return { positions, texels };
}

/** [u w, v w, w] of a homogeneous point of the room in the picture of a camera. */
function texelOf({ transform, frustum: f }, h) {
  const [x, y, z] = apply(invert(transform), h);
  const w = -z;
  return [(x - f.left * w) / (f.right - f.left), (f.up * w - y) / (f.up - f.down), w];
}

/** Upper left, upper right, lower left, lower right of the picture's frustum on the plane. */
function cornersOnPlane({ transform, frustum: f }, point, normal) {
  const eye = place(transform);
  const ends = [[f.left, f.up], [f.right, f.up], [f.left, f.down], [f.right, f.down]];
  const rays = ends.map(([x, y]) => subtract(movePoint(transform, [x, y, -1]), eye));
  const reach = dot(subtract(point, eye), normal);
  const steep = rays.every((ray) => dot(unit(ray), normal) < -GRAZING);
  const straight = Math.max(0.3, Math.abs(reach)); // all rays end at one depth: rays are as long as -z is 1
  return rays.map((ray) => add(eye, scale(ray, steep ? reach / dot(ray, normal) : straight)));
}
