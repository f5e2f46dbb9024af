// Where an avatar touches the ground: soft round shadows [x, z, radius, strength] on the floor.

import { movePoint } from '../space/matrix.js';

const PARTS = ['left_foot', 'right_foot', 'left_ankle', 'right_ankle', 'left_knee', 'right_knee', 'pelvis', 'spine3'];
const BACK = 0.1; // metres from the eyes back to above the ankles of who stands
const NEAR = 0.32; // metres above the floor at which a part has half its shadow

/** Of joints [[x, y, z], ...] in the room as it is shown. */
export function fromJoints(points) {
  return points.map(([x, y, z]) => blob(x, Math.max(y - 0.06, 0), z, 0.11, 0.5));
}

/** The joints whose shadows are seen, of a skeleton in a pose. */
export function partsOf(skeleton, pose) {
  const found = PARTS.map((name) => skeleton.names.indexOf(name)).filter((joint) => joint >= 0);
  return found.map((joint) => skeleton.placeOf(pose, joint));
}

/** [x, z] of who stands below the eyes of `head` [x, y, z, qx, qy, qz, qw]. */
export function below([x, , z, qx, qy, qz, qw]) {
  const [across, along] = [2 * (qx * qz + qw * qy), 1 - 2 * (qx * qx + qy * qy)]; // where +z of the head points
  const length = Math.hypot(across, along) || 1;
  return [x + (BACK * across) / length, z + (BACK * along) / length];
}

/**
 * Of who stands on `feet` [x, y, z of left ankle, left ball, right ankle, right ball], moved by `shown`: of each, and a
 * wide one of the body between them.
 */
export function fromFeet(feet, shown) {
  const points = [0, 3, 6, 9].map((i) => movePoint(shown, feet.slice(i, i + 3)));
  const [x, y, z] = [0, 1, 2].map((k) => points.reduce((sum, point) => sum + point[k] / 4, 0));
  return [...fromJoints(points), blob(x, Math.max(y, 0) + 0.25, z, 0.3, 0.55)];
}

/** Of a box [x0, y0, z0, x1, y1, z1] alone, moved by `shown`; `root`: [x, z] where the body's middle is known. */
export function fromBox(box, shown, root = null) {
  const [x, z] = root ?? [(box[0] + box[3]) / 2, (box[2] + box[5]) / 2];
  const [a, , c] = movePoint(shown, [x, 0, z]);
  const deep = Math.min(0.3, Math.max(0.16, (box[5] - box[2]) / 2));
  const high = Math.max(box[1], 0);
  return [blob(a, high, c, 0.75 * deep + 0.05, 0.62), blob(a, high, c, 0.19, 0.42), blob(a, high + 0.25, c, 0.3, 0.55)];
}

/** Of everybody in a room, whose `people` stand `at` [x, y, z], moved by `shown`. */
export function fromPlaces(people, shown) {
  return people.flatMap(({ at, opacity = 1 }) => {
    const [x, , z] = movePoint(shown, [at[0], 0, at[2]]);
    const high = Math.max(at[1], 0);
    return [blob(x, high, z, 0.2, 0.75 * opacity), blob(x, high + 0.25, z, 0.3, 0.55 * opacity)];
  });
}

/** A round shadow of something `y` above the floor: higher, wider and fainter. */
function blob(x, y, z, radius, strength) {
  return [x, z, radius + 0.45 * y, strength / (1 + (y / NEAR) ** 2)];
}
