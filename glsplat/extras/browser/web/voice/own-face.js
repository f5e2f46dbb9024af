// Where this device draws, one's own face is that of now: what others hear of on the way is known here already.

import { ARKIT } from '../draw/crowd.js';

const byName = (said) => (Array.isArray(said) ? Object.fromEntries(ARKIT.map((name, i) => [name, said[i]])) : (said ?? {}));

export class OwnFace {
  /** What goes with the newest request, and what went with that which was answered last: by name, or in ARKit's order. */
  now = null;
  answered = null;
  #weights = new Float32Array(ARKIT.length);

  /**
   * `expression` [52] of the server's (null: all 0), with what is said now in it. What it has because it was said, and is
   * said no more, is at rest; all else, such as eyes that look about, is the server's. Null where all is 0.
   */
  over(expression) {
    const [now, before] = [byName(this.now), byName(this.answered)];
    const names = Object.keys({ ...before, ...now });
    if (!names.length) return expression;
    this.#weights.set(expression ?? new Float32Array(ARKIT.length));
    for (const name of names) {
      const i = ARKIT.indexOf(name);
      if (i >= 0) this.#weights[i] = Math.min(1, Math.max(0, now[name] ?? 0));
    }
    return this.#weights.some((weight) => weight !== 0) ? this.#weights : null;
  }
}
