// What to ask for: for each eye a camera whose picture covers just the avatar as it is shown, with a margin for what
// moves until the picture is there; and what is needed to put that picture back into the room when it comes.

import { around, aroundQuad, corners, intersection, intrinsics, joined, tangentsOf, widened } from './frustum.js';
import { add, axis, fromPose, movePoint, multiply, place, subtract, translation, turnY, unit, viewmat } from './matrix.js';
import { plane, planeAt, serverEye, standing } from './placing.js';

const BODY = [-0.6, -0.05, -0.6, 0.6, 2.0, 0.6]; // metres about the ground under the head, until the server says more
const HAND = 0.15; // metres around a wrist
const STILL = 0.04; // metres and
const LIMBS = 0.6; // metres a second, by which the box is wider than the last one known
const LATEST = 0.3; // seconds; older pictures are not waited for by wider margins
const MARGIN = 0.03; // radians beyond what the eye sees, and at most
const WIDEST = 0.35;
const SHAPES = [0.5, 0.7, 1, 1.4, 2]; // width / height; few of them, because a server keeps targets of few sizes
const HYSTERESIS = 1.25;
const COMPANY = 1.6; // metres to the plane on which a picture of a whole room is put
const GUEST = [-0.8, -0.05, -0.8, 0.8, 2.1, 0.8]; // metres about where somebody stands
const TRUNK = [-0.4, -0.05, -0.3, 0.4, -0.25, 0.15]; // metres about one's own feet, +z ahead; the upper edge from the eyes
const LEGS = [-0.5, -0.05, -0.3, 0.5, -0.7, 0.6];
const RAISED = -0.45; // metres from the eyes to the upper edge of a hand that hangs down, at most
const FIGURE = 0.42; // squared tangents of the frustum in which a mirror 1.2 m away shows a person whose arms hang
const FINEST = 1.5; // pixels of a picture of a room a pixel of the display, along a side
const MOST = 2; // times the side of the setting that a picture has at most, of a room or of somebody close
const CLOSE = [1.2, 1.4]; // metres from the eye of the flat page to whoever comes close, and to whoever is so no more

export class Framing {
  seen = Infinity; // side of a square with as many pixels as the display has for what was framed last
  largest = Infinity; // side of a square that the server draws
  furnished = false; // whether a room has more to see than people
  #people = []; // {at: [x, y, z], you} of everybody in a room, as the server said it
  #box = null; // as the server said it
  #boxHead = null; // where the head was then: [x, y, z], null where nothing was tracked
  #shapes = [1, 1]; // of pictures, and of those in a mirror
  #close = false; // whether somebody is
  #direction = null; // of the head in the last frame, for its speed
  #time = 0;
  #speed = 0; // radians a second, falling by half in 0.2 s

  /** Learn the box [x0, y0, z0, x1, y1, z1] of the reply to what `frame` returned, in a room where its `people` stand. */
  learn(box, asked, people = []) {
    this.#people = people;
    if (Array.isArray(box) && box.length === 6 && box.every(Number.isFinite)) {
      this.#box = box;
      this.#boxHead = asked.head;
    }
  }

  forget() {
    this.#box = null;
    this.#people = [];
  }

  /**
   * views: [{transform (room from eye), projection}], left first. `where`: a placing; `whole`: everybody in sight.
   * `sample`: the tracking of this moment or null. `side`: the side of a square picture with as many pixels. `age`:
   * seconds that pictures take. `always`: of a room, also if nobody is in sight.
   * Returns {eyes, size} for the request and what `Painter.show` needs with its picture; null if nothing is in sight.
   */
  frame(views, where, sample, side, age, now, always = true) {
    const late = Math.min(age, LATEST);
    this.#turn(views[0].transform, now);
    const head = sample?.head ? sample.head.slice(0, 3) : null;
    const shown = corners(this.#around(sample, head, late)).map((point) => movePoint(where.shown, point));
    const margin = Math.min(WIDEST, MARGIN + this.#speed * late);
    const sights = views.map(({ transform, projection }) => {
      const seen = widened(tangentsOf(projection), margin);
      return where.glass ? clip(seen, aroundQuad(where.glass, transform), margin) : seen;
    });
    const solid = where.whole ? this.#company(where, sample, late) : [shown];
    const cut = sights.map((seen, i) => seen && joined(solid.map((one) => clip(seen, around(one, views[i].transform), 0))));
    // of a room something comes even if nobody is in sight: who comes in is heard of by a reply
    const frusta = where.whole && (always || this.furnished) && cut.every((frustum) => frustum === null) ? sights : cut;
    if (frusta.every((frustum) => frustum === null)) return null;
    const whole = frusta.map((frustum, i) => frustum ?? straightAhead(views[i]));
    this.seen = Math.min(...whole.map((frustum, i) => shownSide(frustum, views[i])));
    const least = where.whole ? this.#roomSide(whole, side) : side;
    const size = this.#size(whole, where.mirror ? 1 : 0, this.#isClose(views[0], where) ? Math.max(least, Math.min(this.seen, MOST * side, this.largest)) : least);
    const eyes = views.map(({ transform }, i) => ({
      viewmat: viewmat(serverEye(where, transform)).map(rounded),
      K: intrinsics(whole[i], size).map(rounded),
    }));
    const cameras = views.map(({ transform }, i) => ({ transform: [...transform], frustum: whole[i] }));
    const ahead = unit(cameras.map(centralRay).reduce(add, [0, 0, 0]));
    const poses = views.map(({ transform }) => transform);
    const on = where.whole && !where.glass ? planeAt(COMPANY, poses, ahead) : plane(shown, poses, ahead);
    return { eyes, size, cameras, plane: on, where, head };
  }

  /** The box of the avatar now: the last one known, moved with the head, and the hands where they are by now. */
  #around(sample, head, late) {
    const from = head && this.#boxHead ? subtract(head, this.#boxHead) : [0, 0, 0];
    const ground = head ? [head[0], 0, head[2]] : [0, 0, 0];
    const base = this.#box ?? BODY;
    const by = this.#box ? from : ground;
    const low = add(base.slice(0, 3), by);
    const high = add(base.slice(3), by);
    low[1] = Math.min(low[1], base[1]); // feet stay on the floor when the head goes down or up
    const grow = STILL + LIMBS * late;
    const box = [...low.map((v) => v - grow), ...high.map((v) => v + grow)];
    for (const hand of sample ? [sample.left, sample.right, sample.left_grip, sample.right_grip] : []) {
      for (let k = 0; hand && k < 3; k++) {
        box[k] = Math.min(box[k], hand[k] - HAND);
        box[3 + k] = Math.max(box[3 + k], hand[k] + HAND);
      }
    }
    return box;
  }

  /** The corners of everybody's box in a room as it is `shown`; none where more is to be seen. */
  #company({ shown, view }, sample, late) {
    if (this.furnished) return [];
    const grow = STILL + LIMBS * late;
    return this.#people.flatMap(({ at, you }) => {
      if (you && view === 'own' && sample?.head) return ownBody(sample);
      const box = GUEST.map((v, k) => v + at[k % 3] + (k < 3 ? -grow : grow));
      return [corners(box).map((point) => movePoint(shown, point))];
    });
  }

  /** The side of a square with the pixels of a picture of a room: as many a degree as of a person alone, up to MOST. */
  #roomSide(frusta, side) {
    const areas = frusta.map(({ left, right, down, up }) => (right - left) * (up - down));
    const wanted = side * Math.sqrt(Math.max(...areas) / FIGURE);
    return Math.min(wanted, MOST * side, FINEST * this.seen, this.largest);
  }

  /** Whether the eye of the flat page is close to somebody: then a picture has the pixels of the display. */
  #isClose({ transform }, { view, whole }) {
    const [x, , z] = place(transform);
    const [x0 = Infinity, , z0, x1, , z1] = this.#box ?? [];
    const away = (whole ? this.#people.map(({ at: [px, , pz] }) => [px, pz]) : [[(x0 + x1) / 2, (z0 + z1) / 2]]).map(([px, pz]) => Math.hypot(px - x, pz - z));
    this.#close = view === 'viewer' && Math.min(...away) < CLOSE[this.#close ? 1 : 0];
    return this.#close;
  }

  #turn(transform, now) {
    const direction = axis(transform, 2);
    const seconds = (now - this.#time) / 1000;
    if (this.#direction && seconds > 0 && seconds < 0.5) {
      const [a, b] = [direction, this.#direction];
      const angle = Math.acos(Math.min(1, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]));
      this.#speed = Math.max(angle / seconds, this.#speed * 0.5 ** (seconds / 0.2));
    }
    this.#direction = direction;
    this.#time = now;
  }

  /** [width, height] of the shape nearest to that of what is to be seen, `side` squared pixels, both eyes alike. */
  #size(frusta, kind, side) {
    const aspects = frusta.map((f) => (f.right - f.left) / (f.up - f.down));
    const aspect = Math.sqrt(aspects.reduce((a, b) => a * b, 1) ** (2 / aspects.length));
    const off = (shape) => Math.abs(Math.log(aspect / shape));
    const best = SHAPES.reduce((a, b) => (off(b) < off(a) ? b : a));
    if (off(best) + Math.log(HYSTERESIS) < off(this.#shapes[kind])) this.#shapes[kind] = best;
    const shape = Math.sqrt(this.#shapes[kind]);
    const block = (length) => Math.max(16, 16 * Math.round(length / 16)); // whole blocks of a JPEG
    return [block(side * shape), block(side / shape)];
  }
}

/** The corners of boxes about what the user sees of the own body: nothing of it while the eyes look ahead and the hands hang. */
function ownBody({ head, ...sample }) {
  const { place: [x, , z], yaw } = standing(fromPose(head));
  const about = multiply(translation([x, 0, z]), turnY(yaw));
  const hands = [sample.left, sample.right, sample.left_grip, sample.right_grip].filter(Boolean);
  const top = Math.max(...hands.map((wrist) => wrist[1] + HAND - head[1]));
  const boxes = top > RAISED ? [TRUNK, LEGS, [...GUEST.slice(0, 4), top, GUEST[5]]] : [TRUNK, LEGS];
  return boxes.map((box) => corners(box.map((v, k) => v + (k === 4 ? head[1] : 0))).map((point) => movePoint(about, point)));
}

/** The side of a square with as many pixels as the display has for a frustum; Infinity for an eye without a display. */
function shownSide({ left, right, down, up }, { projection, viewport }) {
  if (!viewport?.width || !viewport.height) return Infinity;
  const [across, along] = [(right - left) * viewport.width * projection[0], (up - down) * viewport.height * projection[5]];
  return Math.max(64, Math.sqrt(across * along) / 2);
}

/** A frustum cut by another one, which may be null (nothing of it in sight), widened by an angle. */
function clip(frustum, other, margin) {
  return other && intersection(frustum, margin ? widened(other, margin) : other);
}

/** A narrow frustum for the eye that sees nothing while the other one does. */
function straightAhead({ projection }) {
  const { left, right, down, up } = tangentsOf(projection);
  const [x, y] = [(left + right) / 2, (down + up) / 2];
  return { left: x - 0.05, right: x + 0.05, down: y - 0.05, up: y + 0.05 };
}

/** The direction in the room of the middle of a camera's picture. */
function centralRay({ transform, frustum }) {
  const x = (frustum.left + frustum.right) / 2;
  const y = (frustum.down + frustum.up) / 2;
  const tip = movePoint(transform, [x, y, -1]);
  return unit(subtract(tip, place(transform)));
}

const rounded = (value) => Math.round(value * 1e7) / 1e7;
