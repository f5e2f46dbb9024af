// Requests smaller pictures while the user speaks to a slow server: a late mouth is worse than a less sharp one.

const SOON = 1000 / 30; // ms a picture; above it, request no more pixels than the display shows
const ENOUGH = 1000 / 15; // ms a picture; above it, request fewer
const STEP = 0.75; // factor of a picture's side, for each step down
const LEAST = 256; // pixels of a side
const PATIENCE = 400; // ms between two steps down
const CALM = 5000; // ms of silence before pictures get their full size again

export class Hurry {
  #share = 1;
  #slow = false; // pictures took longer than SOON while the user spoke
  #spoke = -Infinity;
  #changed = -Infinity;

  /**
   * Return the side to request instead of `side`, pixels. `speaks`: the mouth moves; `times`: {render, encode} of the
   * last picture, ms; `seen`: the side with as many pixels as the display has for it.
   */
  side(side, speaks, { render = 0, encode = 0 } = {}, now, seen = Infinity) {
    if (speaks) this.#spoke = now;
    if (now - this.#spoke > CALM) [this.#share, this.#slow] = [1, false];
    else this.#slow ||= render + encode > SOON;
    const whole = this.#slow ? Math.min(side, Math.max(seen, LEAST)) : side; // `seen` grows as the viewer comes nearer
    if (this.#slow && render + encode > ENOUGH && now - this.#changed > Math.max(PATIENCE, 2 * (render + encode)) && whole * this.#share * STEP >= LEAST) {
      this.#share *= STEP;
      this.#changed = now;
    }
    return Math.round(whole * this.#share);
  }
}
