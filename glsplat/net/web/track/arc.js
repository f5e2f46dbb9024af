// Stepping without a stick: a pinch or a squeeze that is held throws an arc from the hand to the floor.

import { add, cross, scale, subtract, unit } from '../space/matrix.js';

const HOLD = 300; // ms; what is shorter presses the panel, or goes to the next view
const SPEED = 4; // metres a second: 2 m from a level hand
const GRAVITY = 9.8;
const PIECES = 20;
const WIDE = 0.01; // metres from the middle of the line to its edges
const RING = { inner: 0.2, outer: 0.26, pieces: 24 }; // metres
const INK = { free: [0.37, 0.83, 0.54, 1], taken: [0.86, 0.3, 0.26, 1] };

export class Arc {
  source = null; // the input source that holds it
  #since = 0; // ms
  #points = []; // from the hand to the floor; none until it was held long enough
  #free = false; // whether the user may stand at the last one

  begin(source, now) {
    [this.source, this.#since, this.#points] = [source, now, []];
  }

  /** Follow the hand's `ray` {origin, direction}; `free(point)`: whether the user may stand there. */
  follow({ origin, direction }, now, free) {
    if (now - this.#since < HOLD) return;
    const rise = SPEED * direction[1];
    const seconds = (rise + Math.sqrt(rise * rise + 2 * GRAVITY * Math.max(origin[1], 0))) / GRAVITY;
    this.#points = Array.from({ length: PIECES + 1 }, (_, i) => {
      const t = (seconds * i) / PIECES;
      return add(add(origin, scale(direction, SPEED * t)), [0, (-GRAVITY * t * t) / 2, 0]);
    });
    this.#free = free(this.#points.at(-1));
  }

  /** Whether it was held long enough. */
  get aims() {
    return this.#points.length > 0;
  }

  /** End it. Returns where the user is to stand, undefined if it was too short or somebody stands there. */
  end() {
    const to = this.#free ? this.#points.at(-1) : undefined;
    [this.source, this.#points] = [null, []];
    return to;
  }

  /** The line, and a ring where the user would stand, as triangle strips for the painter; `eye`: where they are seen from. */
  marks(eye) {
    const points = this.#points;
    if (!points.length) return [];
    const line = points.flatMap((point, i) => {
      const along = subtract(points[Math.min(i + 1, PIECES)], points[Math.max(i - 1, 0)]);
      const aside = scale(unit(cross(along, subtract(eye, point))), WIDE);
      return [subtract(point, aside), add(point, aside)];
    });
    const ring = Array.from({ length: 2 * (RING.pieces + 1) }, (_, i) => {
      const [angle, radius] = [(2 * Math.PI * (i >> 1)) / RING.pieces, i % 2 ? RING.outer : RING.inner];
      return add(points.at(-1), [radius * Math.cos(angle), 0, radius * Math.sin(angle)]);
    });
    const paint = this.#free ? INK.free : INK.taken;
    return [{ strip: line, paint }, ...(this.#free ? [{ strip: ring, paint }] : [])];
  }
}
