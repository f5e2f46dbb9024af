// Smaller pictures while somebody speaks, where the server is slow: a mouth that moves late is worse than one less sharp.

const SOON = 1000 / 30; // ms that a picture may take before it has no more pixels than are seen
const ENOUGH = 1000 / 15; // ... before it has fewer
const STEP = 0.75; // of a picture's side, at a time
const LEAST = 256; // pixels of a side
const PATIENCE = 400; // ms that a smaller picture has to show what it gains
const CALM = 5000; // ms of silence after which pictures are whole again

export class Hurry {
  #share = 1;
  #slow = false; // pictures take long while one speaks
  #spoke = -Infinity;
  #changed = -Infinity;

  /**
   * The side to ask for instead of `side`; `speaks` says whether a mouth moves, `times` {render, encode} of the last, `seen`
   * which side would have as many pixels as the display has for it.
   */
  side(side, speaks, { render = 0, encode = 0 } = {}, now, seen = Infinity) {
    if (speaks) this.#spoke = now;
    if (now - this.#spoke > CALM) [this.#share, this.#slow] = [1, false];
    else this.#slow ||= render + encode > SOON;
    const whole = this.#slow ? Math.min(side, Math.max(seen, LEAST)) : side; // goes with `seen`: who comes nearer sees more
    if (this.#slow && render + encode > ENOUGH && now - this.#changed > Math.max(PATIENCE, 2 * (render + encode)) && whole * this.#share * STEP >= LEAST) {
      this.#share *= STEP;
      this.#changed = now;
    }
    return Math.round(whole * this.#share);
  }
}
