// Where the panel hangs, and what points at it.

import { add, axis, dot, fromPose, movePoint, place, scale, subtract, turnY, unit } from '../space/matrix.js';
import { heading } from '../space/placing.js';

// metres; from the glass's edge to the panel's middle, before the glass, over the floor: its text is a degree high
const BESIDE = { width: 0.45, away: 0.05, before: 0.35, height: 1.3 };
const WRIST = { width: 0.24, left: 0.22, back: 0.06 }; // beside the wrist, as its user sees it: it hides no hand
const BEFORE = { width: 0.4, ahead: 0.7, left: 0.45, down: 0.25 };
const BODY = 0.6; // of a person whom the panel does not cover
const EYES = 0.07; // from the left to the right, at most
const FARTHEST = 0.9; // radians that it goes aside for that

/**
 * {transform: room from panel, width}: beside the mirror, else by the left wrist, else before the user to the left, there
 * aside of the `others`, whose heads are at [x, y, z].
 */
export function panelPlace(where, head, sample, others = []) {
  const eye = place(head);
  if (where.glass) {
    const [low, right] = where.glass;
    const aside = add(right, scale(unit(subtract(right, low)), BESIDE.away));
    const beside = add(aside, scale(where.normal, BESIDE.before));
    return { transform: facing([beside[0], BESIDE.height, beside[2]], head), width: BESIDE.width };
  }
  const hung = (point, width) => ({ transform: facing(clearOf(others, eye, point, width), head), width });
  const wrist = sample.left ?? sample.left_grip;
  if (wrist) {
    const back = axis(fromPose(wrist), 2); // a wrist's -z leads to the fingers
    const aside = add(scale(axis(head, 0), -WRIST.left), scale(back, WRIST.back));
    return hung(add(wrist.slice(0, 3), aside), WRIST.width);
  }
  const ahead = heading(head);
  const left = [ahead[2], 0, -ahead[0]];
  const aside = add(scale(left, BEFORE.left), [0, -BEFORE.down, 0]);
  return hung(add(add(eye, scale(ahead, BEFORE.ahead)), aside), BEFORE.width);
}

/** Turn a panel's point to the left about the eye, to where a panel of that width covers least of the bodies under these heads. */
function clearOf(others, eye, point, width) {
  const from = ([x, , z]) => [x - eye[0], z - eye[2]];
  const [px, pz] = from(point);
  const bodies = others.map((head) => {
    const [x, z] = from(head);
    const away = Math.atan2(pz * x - px * z, px * x + pz * z); // to the left of the point
    return { away, reach: Math.atan2(BODY / 2, Math.hypot(x, z)) + Math.atan2((width + EYES) / 2, Math.hypot(px, pz)) };
  });
  const covered = (by) => bodies.reduce((sum, { away, reach }) => sum + Math.max(0, reach - Math.abs(away - by)), 0);
  const ways = [0, ...bodies.map(({ away, reach }) => away + reach + 1e-6)].filter((by) => by >= 0 && by < FARTHEST).sort((a, b) => a - b);
  const by = ways.reduce((best, one) => (covered(one) < covered(best) ? one : best));
  return add(eye, movePoint(turnY(by), subtract(point, eye)));
}

/** Rays {origin, direction} of input sources, in the room. */
export function pointers(frame, space, sources) {
  const rays = [];
  for (const source of sources) {
    const found = source.targetRaySpace && frame.getPose(source.targetRaySpace, space);
    if (!found) continue;
    const m = found.transform.matrix;
    rays.push({ origin: place(m), direction: scale(axis(m, 2), -1) });
  }
  return rays;
}

/** A pose at `point` whose z axis points to the head, and whose x axis is as level as the head's own. */
function facing(point, head) {
  const z = unit(subtract(place(head), point));
  const right = axis(head, 0);
  const x = unit(subtract(right, scale(z, dot(right, z))));
  const y = [z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]];
  return [...x, 0, ...y, 0, ...z, 0, ...point, 1];
}
