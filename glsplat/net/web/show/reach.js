// Where the panel hangs, and what points at it.

import { add, axis, dot, fromPose, place, scale, subtract, unit } from '../space/matrix.js';
import { heading } from '../space/placing.js';

// metres; from the glass's edge to the panel's middle, before the glass, over the floor: its text is a degree high
const BESIDE = { width: 0.45, away: 0.05, before: 0.35, height: 1.3 };
const WRIST = { width: 0.24, left: 0.22, back: 0.06 }; // beside the wrist, as its user sees it: it hides no hand
const BEFORE = { width: 0.4, ahead: 0.7, left: 0.45, down: 0.25 };

/** {transform: room from panel, width}: beside the mirror, else by the left wrist, else before the user to the left. */
export function panelPlace(where, head, sample) {
  const eye = place(head);
  if (where.glass) {
    const [low, right] = where.glass;
    const aside = add(right, scale(unit(subtract(right, low)), BESIDE.away));
    const beside = add(aside, scale(where.normal, BESIDE.before));
    return { transform: facing([beside[0], BESIDE.height, beside[2]], head), width: BESIDE.width };
  }
  const wrist = sample.left ?? sample.left_grip;
  if (wrist) {
    const back = axis(fromPose(wrist), 2); // a wrist's -z leads to the fingers
    const aside = add(scale(axis(head, 0), -WRIST.left), scale(back, WRIST.back));
    const point = add(wrist.slice(0, 3), aside);
    return { transform: facing(point, head), width: WRIST.width };
  }
  const ahead = heading(head);
  const left = [ahead[2], 0, -ahead[0]];
  const aside = add(scale(left, BEFORE.left), [0, -BEFORE.down, 0]);
  return { transform: facing(add(add(eye, scale(ahead, BEFORE.ahead)), aside), head), width: BEFORE.width };
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
