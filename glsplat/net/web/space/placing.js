// Where the avatar is shown: in the mirror, facing its user, or as the user's own body. Twin:
// glsplat/extras/openxr/placing.py.
//
// The server draws the avatar where its user is. `shown` takes that room to the room as it is shown, and an eye that
// looks at the shown room is sent to the server as the eye that sees the same thing in the user's own.

import { add, axis, FLIP_X, IDENTITY, invert, multiply, place, reflection, scale, subtract } from './matrix.js';
import { movePoint, translation, turnY, unit } from './matrix.js';

export const VIEWS = ['mirror', 'facing', 'own'];

const MIRROR = { distance: 1.2, width: 1.1, bottom: 0.05, top: 2.05 }; // metres
const ASIDE = 0.4; // metres from the circle of a room to a mirror, at least
const FACING = 1.8; // metres from the user to the avatar

/** The level direction a head looks in; [0, 0, -1] if it looks straight up or down. */
export function heading(head) {
  const back = axis(head, 2);
  const level = [-back[0], 0, -back[2]];
  if (Math.hypot(level[0], level[2]) > 0.1) return unit(level);
  const up = axis(head, 1); // looking down, the head's up is ahead; looking up, behind
  const sign = back[1] > 0 ? 1 : -1;
  return Math.hypot(up[0], up[2]) > 0.1 ? unit([sign * up[0], 0, sign * up[2]]) : [0, 0, -1];
}

/**
 * A view for a user whose head is at `head` (room from head): what stays where it is until the view is chosen again.
 * In a room, whose circle of `radius` metres the user faces from the origin, all that is in sight is shown; once there
 * is `company`, the mirror is `hung` to the user's left, where nobody stands behind it.
 */
export function placing(view, head, radius = 0, company = false) {
  if (radius && !company && view === 'mirror') return { ...placing(view, head), whole: true };
  if (radius) {
    const around = { ...placing('own', head), whole: true };
    return view === 'mirror' ? { ...around, hung: { ...mirrorAt([radius + ASIDE, 0, 0], [-1, 0, 0]), whole: true } } : around;
  }
  const ahead = heading(head);
  const ground = [head[12], 0, head[14]];
  if (view === 'mirror') return mirrorAt(add(ground, scale(ahead, MIRROR.distance)), scale(ahead, -1));
  if (view === 'facing') {
    const pivot = add(ground, scale(ahead, FACING / 2));
    const shown = multiply(translation(pivot), multiply(turnY(Math.PI), translation(scale(pivot, -1))));
    return { view, shown, mirror: false, glass: null };
  }
  return { view: 'own', shown: [...IDENTITY], mirror: false, glass: null };
}

/** An upright mirror that stands at `foot` (on the floor) and looks along the level unit vector `normal`. */
function mirrorAt(foot, normal) {
  const side = [normal[2] * (MIRROR.width / 2), 0, -normal[0] * (MIRROR.width / 2)]; // to the right as its user sees it
  const corner = (sign, height) => add(add(foot, scale(side, sign)), [0, height, 0]);
  const glass = [
    corner(-1, MIRROR.bottom),
    corner(1, MIRROR.bottom),
    corner(1, MIRROR.top),
    corner(-1, MIRROR.top),
  ];
  return { view: 'mirror', shown: reflection(foot, normal), mirror: true, glass, normal };
}

/** The server's eye (its pose in the user's own room) for an eye at `transform` in the shown room. */
export function serverEye({ shown, mirror }, transform) {
  // with mirror the server draws viewmat * FLIP_X: that has to be the eye's view of the reflected room
  return multiply(mirror ? multiply(FLIP_X, shown) : invert(shown), transform);
}

/**
 * The plane on which a picture of the shown box [8 corners] is put: through its middle, upright and turned to the
 * eyes where they see enough of it, else straight before them. `eyes`: their poses in the room.
 */
export function plane(points, eyes, ahead) {
  const middle = scale(points.reduce(add, [0, 0, 0]), 1 / points.length);
  const eye = scale(eyes.map(place).reduce(add, [0, 0, 0]), 1 / eyes.length);
  const away = subtract(middle, eye);
  const level = Math.hypot(away[0], away[2]);
  if (level > 0.5 && level > Math.abs(away[1]) && away[0] * ahead[0] + away[1] * ahead[1] + away[2] * ahead[2] > 0) {
    return { point: middle, normal: [-away[0] / level, 0, -away[2] / level] };
  }
  return planeAt(NEAR_BODY, eyes, ahead);
}

/** The plane so many metres straight before the eyes. */
export function planeAt(distance, eyes, ahead) {
  const eye = scale(eyes.map(place).reduce(add, [0, 0, 0]), 1 / eyes.length);
  return { point: add(eye, scale(ahead, distance)), normal: scale(ahead, -1) };
}

/**
 * {place, yaw}: where a space has to be put, and turned about y, for this head to be over its origin, looking along +z.
 */
export function standing(head) {
  const ahead = heading(head);
  return { place: [head[12], 0, head[14]], yaw: Math.atan2(ahead[0], ahead[2]) };
}

const NEAR_BODY = 0.5; // metres to the arms and the lap of one's own body

/** Between the eyes that look at the shown room, in the user's own: what an avatar is to look at. */
export function watcher(views, { shown }) {
  const eye = scale(views.map(({ transform }) => place(transform)).reduce(add, [0, 0, 0]), 1 / views.length);
  return movePoint(invert(shown), eye).map((v) => Math.round(v * 1000) / 1000);
}
