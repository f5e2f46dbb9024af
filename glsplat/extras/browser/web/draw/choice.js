// Who draws: the server, which sends pictures, or this device. Pictures first; over to drawing here once there is
// something to draw and it was measured to be faster; back where the display's rate is not kept.

const SHARE = 0.8; // of the display's rate, below which, for
const PATIENCE = 3000; // ms, it is back to pictures, and
const WATCHED = 2000; // ms of pictures, whose rate is known then
const PAUSE = 60_000; // ms pass until it is tried again, twice as many each time

export class Choice {
  here = false; // this device draws
  reason = 'pictures come first'; // in words, for the panel
  #wish;
  #display = 60; // Hz
  #times = []; // ms, frames of the last two seconds
  #begun = null; // ms
  #slow = null; // ms, since when it is too slow
  #until = 0; // ms, not before
  #pause = PAUSE;

  /** `wish`: a value of the setting `drawn`. */
  constructor(wish = 'auto') {
    this.#wish = wish;
  }

  set wish(wish) {
    this.#wish = wish;
    this.#until = 0;
    this.#pause = PAUSE;
    if (wish === 'server') this.#back('you chose the server');
  }

  /** This device was chosen: nothing is to be compared. */
  get settled() {
    return this.#wish === 'here';
  }

  /** What the display can: Hz, as a headset says it. Else it is learnt from frames while pictures are shown. */
  set display(hertz) {
    if (hertz > 0) this.#display = hertz;
  }

  get display() {
    return this.#display;
  }

  /**
   * Whether it has to be measured now: `able` '' or why nothing can be drawn here, `now` ms. Then call `measured`.
   */
  asks(able, now) {
    if (able) {
      this.#back(able);
      return false;
    }
    const known = this.#wish === 'here' || (this.#begun !== null && now - this.#begun >= WATCHED);
    return !this.here && known && this.#wish !== 'server' && now >= this.#until;
  }

  /** A picture took `ms` here; the server's come at `rate` a second. */
  measured(ms, rate, now) {
    const own = Math.min(1000 / ms, this.#display);
    if (this.#wish === 'here' ? Number.isFinite(ms) : own > rate) {
      Object.assign(this, { here: true, reason: `${own.toFixed(0)} pictures a second here, ${rate.toFixed(0)} from the server` });
      [this.#slow, this.#times] = [null, []];
    } else {
      this.#later(now, `the server is faster: ${rate.toFixed(0)} pictures a second, ${own.toFixed(0)} here`);
    }
  }

  /** A frame of the display begins at `now`, ms. */
  frame(now) {
    this.#begun ??= now;
    this.#times.push(now);
    while (this.#times[0] < now - 2000) this.#times.shift();
    const span = now - this.#times[0];
    if (span < 500) return;
    const rate = ((this.#times.length - 1) * 1000) / span;
    if (!this.here) {
      if (rate > this.#display) this.#display = rate; // a display is as fast as it was ever seen to be
      return;
    }
    if (rate >= SHARE * this.#display) this.#slow = null;
    else this.#slow ??= now;
    if (this.#wish === 'auto' && this.#slow !== null && now - this.#slow >= PATIENCE) {
      this.#later(now, `this device drew ${rate.toFixed(0)} of ${this.#display.toFixed(0)} pictures a second`);
    }
  }

  #later(now, reason) {
    this.#until = now + this.#pause;
    this.#pause *= 2;
    this.#back(reason);
  }

  #back(reason) {
    Object.assign(this, { here: false, reason });
    this.#slow = null;
    this.#times = [];
  }
}
