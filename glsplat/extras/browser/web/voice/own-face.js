// The user's own face, drawn by this device without the delay of the server.

import { ARKIT } from '../draw/crowd.js';

const byName = (said) => (Array.isArray(said) ? Object.fromEntries(ARKIT.map((name, i) => [name, said[i]])) : (said ?? {}));

export class OwnFace {
  /** Expressions of the newest request and of the one answered last: by name, or in ARKit's order. */
  now = null;
  answered = null;
  #weights = new Float32Array(ARKIT.length);

  /**
   * Return the server's `expression` [52] (null: all 0) with the weights of `now`. Weights that only the answered
   * request had are 0; others, such as eye movements of the server, stay. Null if all are 0.
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
