// Where the panel hangs, and what points at it.

import { add, axis, place, scale, subtract, unit } from '../space/matrix.js';
import { heading } from '../space/placing.js';

const BESIDE = 0.3; // metres from the glass to the panel's middle
const OVER = 0.16; // metres above a wrist

/** Room from panel: beside the mirror, else over the left wrist, else before the user to the left. */
export function panelPlace(where, head, sample) {
  const eye = place(head);
  if (where.glass) {
    const [low, right] = where.glass;
    const side = unit(subtract(right, low));
    return facing(add(add(right, scale(side, BESIDE)), [0, 1.3 - right[1], 0]), eye);
  }
  const wrist = sample.left ?? sample.left_grip;
  if (wrist) return facing(add(wrist.slice(0, 3), [0, OVER, 0]), eye);
  const ahead = heading(head);
  const left = [ahead[2], 0, -ahead[0]];
  return facing(add(add(eye, scale(ahead, 0.7)), add(scale(left, 0.45), [0, -0.25, 0])), eye);
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

/** An upright pose at `point` whose z axis points to `eye`. */
function facing(point, eye) {
  const z = unit(subtract(eye, point));
  const x = unit([z[2], 0, -z[0]]);
  const y = [z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]];
  return [...x, 0, ...y, 0, ...z, 0, ...point, 1];
}
