// Names over the heads of a room's people, as one eye sees them: of one apparent size, over nobody's head or body.

import { add, cross, dot, invert, movePoint, multiply, place, scale, subtract, translation, unit } from '../space/matrix.js';
import { Board } from './panel.js';

const FARTHEST = 10; // metres; names of people beyond it are hidden
const OVER = 0.24; // metres from the joint of the head to the name's lower edge
const BODY = 0.6; // metres; width of a body that no other name covers
const [SMALLEST, PIXELS] = [0.036, 34]; // height of a name: as a tangent, and in pixels, whichever is more
const CANVAS = { width: 768, height: 72, pad: 14, gap: 12 };
const INK = { ground: 'rgba(16,20,28,0.82)', name: '#ffffff', rest: '#c3cede', speaks: '#5fd38a' };

export class Names {
  #boards = new Map(); // by key
  #spare = [];
  #speaking = new Set();

  /** Mark the person of that name as speaking, or not. */
  speaking(name, on) {
    this.#speaking[on ? 'add' : 'delete'](name);
  }

  /** Return whether the person of that name speaks. */
  speaks(name) {
    return this.#speaking.has(name);
  }

  /**
   * Return labels for the painter of `people` [{key, name, label, you, head (joint, as shown), glass}], but of the user, for an
   * eye {transform, projection, viewport}. In a mirror only those that are seen through its `glass`. On a `flat` screen they
   * are parallel to it, as it has no lens that undoes how a wide picture stretches its sides.
   */
  labels(people, eye, painter, flat) {
    const from = place(eye.transform);
    const tall = Math.max(SMALLEST, (2 * PIXELS) / (eye.viewport.height * eye.projection[5]));
    const shown = people.filter(({ glass, head }) => !glass || through(glass, from, head));
    const seen = shown.map((one) => (flat ? onScreen : seenFrom)(eye.transform, one)).filter(({ far }) => far > 0.3 && far < FARTHEST);
    const named = seen.filter(({ one }) => !one.you);
    const keys = new Set(named.map(({ one }) => one.key));
    for (const [key, board] of this.#boards) {
      if (keys.has(key)) continue;
      this.#spare.push(board);
      this.#boards.delete(key);
    }
    for (const each of named) {
      if (!this.#boards.has(each.one.key)) this.#boards.set(each.one.key, this.#spare.pop() ?? new Name());
      const board = this.#boards.get(each.one.key);
      board.write(each.one.name, remark(each.one.label), this.speaks(each.one.name));
      [each.wide, each.high] = [(tall * board.wide) / CANVAS.height, tall];
    }
    return apart(named, seen).map(({ one, far, up, hang }) => {
      const board = this.#boards.get(one.key);
      board.transform = hang(up);
      return board.shown(painter, tall * far);
    });
  }
}

class Name extends Board {
  #text = [];
  wide = 0; // pixels that are not empty

  constructor() {
    super(CANVAS.width, CANVAS.height);
  }

  write(...text) {
    if (text.every((word, i) => word === this.#text[i])) return;
    this.#text = text;
    this.wide = Math.min(CANVAS.width, this.#lines().reduce((most, [words, font]) => Math.max(most, this.#measure(words, font)), 0) + 2 * CANVAS.pad);
  }

  /** Return the label for the painter, `tall` metres high. */
  shown(painter, tall) {
    return this.label(painter, this.#text.join('\n'), (ink) => this.#paint(ink), (tall * CANVAS.width) / CANVAS.height);
  }

  #lines() {
    const [name, rest, speaks] = this.#text;
    return [[speaks ? `● ${name}` : name, '600 36px system-ui, sans-serif', speaks ? INK.speaks : INK.name, 24], [rest, '22px system-ui, sans-serif', INK.rest, 55]];
  }

  #measure(words, font) {
    this.ink.font = font;
    return this.ink.measureText(words).width;
  }

  #paint(ink) {
    const { width, height, pad, gap } = CANVAS;
    ink.fillStyle = INK.ground;
    ink.beginPath();
    ink.roundRect((width - this.wide) / 2, 0, this.wide, height, gap);
    ink.fill();
    [ink.textAlign, ink.textBaseline] = ['center', 'middle'];
    for (const [words, font, colour, middle] of this.#lines()) {
      [ink.font, ink.fillStyle] = [font, colour];
      ink.fillText(words, width / 2, middle, width - 2 * pad);
    }
  }
}

/** Return what a label says besides the driver's name, which has no comma. */
const remark = (label) => label.slice(label.indexOf(',') + 1).trim();

/** Where a person is from an eye: level angle and distance, the tangent of the upper edge of the head, and the pose of a name over it. */
function seenFrom(transform, one) {
  const from = place(transform);
  const [x, y, z] = subtract(one.head, from);
  const far = Math.hypot(x, z);
  const hang = (up) => facing([one.head[0], from[1] + up * far, one.head[2]], from);
  return { one, far, across: Math.atan2(x, -z), top: (y + OVER) / far, hang };
}

/** The same in the tangents of a flat screen. */
function onScreen(transform, one) {
  const [x, y, z] = movePoint(invert(transform), add(one.head, [0, OVER, 0]));
  return { one, far: -z, across: -x / z, top: -y / z, hang: (up) => multiply(transform, translation([x, -up * z, z])) };
}

/** Whether the line from an eye to a point goes through a glass (4 corners around it). */
function through([low, right, , left], eye, point) {
  const [u, v, ray] = [subtract(right, low), subtract(left, low), subtract(point, eye)];
  const normal = cross(u, v);
  const t = dot(subtract(low, eye), normal) / dot(ray, normal);
  const on = subtract(add(eye, scale(ray, t)), low);
  const [a, b] = [dot(on, u) / dot(u, u), dot(on, v) / dot(v, v)];
  return t > 0 && t < 1 && a >= 0 && a <= 1 && b >= 0 && b <= 1;
}

/** Return an upright pose at `point` whose z axis points to an eye. */
function facing(point, eye) {
  const away = subtract(eye, point);
  const z = unit([away[0], 0, away[2]]);
  return [z[2], 0, -z[0], 0, 0, 1, 0, 0, ...z, 0, ...point, 1];
}

/** Return the names with `up`, the tangent of each one's middle: as low as nobody and no nearer name is covered. */
function apart(named, people) {
  const taken = [];
  const bodies = people.map(({ one, across, far, top }) => ({ one, across, wide: BODY / far, from: -Infinity, to: top }));
  for (const each of [...named].sort((a, b) => a.far - b.far)) {
    const beside = [...bodies, ...taken].filter((other) => turned(each.across, other.across) < (each.wide + other.wide) / 2);
    let low = each.top;
    for (const other of beside.sort((a, b) => a.to - b.to)) {
      if (low < other.to && low + each.high > other.from) low = other.to;
    }
    taken.push({ across: each.across, wide: each.wide, from: low, to: low + 1.1 * each.high });
    each.up = low + each.high / 2;
  }
  return named;
}

/** The angle between two directions, 0 to pi. */
const turned = (a, b) => Math.abs(((a - b + 3 * Math.PI) % (2 * Math.PI)) - Math.PI);

/** Return the people [{key, name, label, you, head}] of a reply in pictures, as `where` shows them. */
export function headsOf(room, where) {
  return (room?.people ?? [])
    .filter(({ head, opacity }) => opacity > 0 && Array.isArray(head) && head.length === 3 && head.every(Number.isFinite))
    .map(({ name, label, you, head }) => ({ key: `${name}${where.glass ? '/' : ''}`, name, label: label ?? '', you, head: movePoint(where.shown, head), glass: where.glass }));
}
