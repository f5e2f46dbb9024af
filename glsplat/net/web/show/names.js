// Names over people's heads, where this device draws them itself.

import { axis, place, subtract, unit } from '../space/matrix.js';
import { Notice } from './panel.js';

export class Names {
  #boards = new Map(); // by key

  /** Labels for the painter of [{key, text, place}], turned to an eye at `transform`. */
  labels(names, transform, painter) {
    const keys = new Set(names.map(({ key }) => key));
    for (const key of this.#boards.keys()) if (!keys.has(key)) this.#boards.delete(key);
    return names.map(({ key, text, place: at }) => {
      if (!this.#boards.has(key)) this.#boards.set(key, new Notice());
      const board = this.#boards.get(key);
      board.text = text;
      board.transform = facing(at, transform);
      return board.label(painter);
    });
  }
}

/** A pose at `point`, upright, whose z axis points to an eye. */
function facing(point, eye) {
  const away = subtract(place(eye), point);
  const z = unit([away[0], 0, away[2]]);
  if (!z[0] && !z[2]) return [...axis(eye, 0), 0, ...axis(eye, 1), 0, ...axis(eye, 2), 0, ...point, 1];
  return [z[2], 0, -z[0], 0, 0, 1, 0, 0, ...z, 0, ...point, 1];
}
