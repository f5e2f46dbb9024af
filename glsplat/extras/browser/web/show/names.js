// Names over people's heads, for people that this device draws.

import { axis, place, subtract, unit } from '../space/matrix.js';
import { Notice } from './panel.js';

const BOARD = { width: 0.7, height: 0.095 }; // metres of a Notice, with a gap

export class Names {
  #boards = new Map(); // by key

  /**
   * Return labels for the painter of [{key, text, place}], facing an eye at `transform`; those behind others are
   * higher.
   */
  labels(names, transform, painter) {
    const keys = new Set(names.map(({ key }) => key));
    for (const key of this.#boards.keys()) if (!keys.has(key)) this.#boards.delete(key);
    return apart(names, place(transform)).map(({ key, text, place: at }) => {
      if (!this.#boards.has(key)) this.#boards.set(key, new Notice());
      const board = this.#boards.get(key);
      board.text = text;
      board.transform = facing(at, transform);
      return board.label(painter);
    });
  }
}

/** Return an upright pose at `point` whose z axis points to an eye. */
function facing(point, eye) {
  const away = subtract(place(eye), point);
  const z = unit([away[0], 0, away[2]]);
  if (!z[0] && !z[2]) return [...axis(eye, 0), 0, ...axis(eye, 1), 0, ...axis(eye, 2), 0, ...point, 1];
  return [z[2], 0, -z[0], 0, 0, 1, 0, 0, ...z, 0, ...point, 1];
}

/** Return the names, nearest first, each raised until no nearer one hides it. */
function apart(names, eye) {
  const seen = names.map((name) => {
    const [x, y, z] = subtract(name.place, eye);
    return { name, across: Math.atan2(x, -z), far: Math.hypot(x, z), y };
  });
  seen.sort((a, b) => a.far - b.far);
  const placed = [];
  for (const one of seen) {
    const far = Math.max(one.far, 0.1);
    const [wide, high] = [BOARD.width / far, BOARD.height / far];
    let up = one.y / far; // a tangent
    for (const other of [...placed].sort((a, b) => a.up - b.up)) {
      const aside = Math.abs(((one.across - other.across + 3 * Math.PI) % (2 * Math.PI)) - Math.PI);
      if (aside < (wide + other.wide) / 2 && Math.abs(up - other.up) < (high + other.high) / 2) {
        up = other.up + (high + other.high) / 2;
      }
    }
    placed.push({ across: one.across, wide, high, up });
    one.name = { ...one.name, place: [one.name.place[0], eye[1] + up * far, one.name.place[2]] };
  }
  return seen.map(({ name }) => name);
}
