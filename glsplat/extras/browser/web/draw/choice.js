// Chooses whether the server draws, and sends pictures, or this device. Pictures come first. The device takes over once
// it has an avatar and was measured to be faster, and gives back when the page loses the rate that it had before.

const GAIN = 1.25; // times the server's pictures a second: less is not worth a change
const SHARE = 0.8; // of the page's frames a second with the server's pictures; if slower for
const PATIENCE = 3000; // ms, the server draws again
const WATCHED = 2000; // ms of pictures before their rate is known
const PAUSE = 60_000; // ms before another try; doubles each time

export class Choice {
  here = false; // this device draws
  reason = 'sessions start with its pictures'; // of the choice, in words
  #wish;
  #display = 60; // Hz
  #pace = 60; // frames of the page a second, the server's pictures and the room in them
  #theirs = 0; // the server's pictures a second, before this device took over
  #times = []; // ms, frames of the last two seconds
  #begun = null; // ms
  #slow = null; // ms, start of being too slow
  #until = 0; // ms, time of the next try; before it the server draws
  #pause = PAUSE;

  /** `wish`: a value of the setting `drawn`. */
  constructor(wish = 'auto') {
    this.wish = wish;
  }

  set wish(wish) {
    this.#wish = wish;
    this.#until = 0;
    this.#pause = PAUSE;
    if (wish === 'server') this.#back('you chose the server');
  }

  /** Whether the user chose the server, so that this device needs no avatar. */
  get declined() {
    return this.#wish === 'server';
  }

  /** Whether the user chose this device, so that no comparison is needed. */
  get settled() {
    return this.#wish === 'here';
  }

  /** Refresh rate of the display in Hz, where a headset reports it; otherwise learnt from the page's frames. */
  set display(hertz) {
    if (hertz > 0) this.#display = hertz;
  }

  get display() {
    return this.#display;
  }

  /** Whether the server draws, and will after its next picture: a frame before that may be left out. */
  rests(now) {
    return !this.here && (this.#wish === 'server' || now < this.#until);
  }

  /**
   * Return whether to measure now, and then call `measured`. `able`: '' or why nothing can be drawn here; `now`: ms.
   */
  asks(able, now) {
    if (able) {
      this.#back(able);
      return false;
    }
    const known = this.#wish === 'here' || (this.#begun !== null && now - this.#begun >= WATCHED);
    return !this.here && known && this.#wish !== 'server' && now >= this.#until;
  }

  /** Choose by the time of the people alone in a picture here, `ms`, and the server's pictures per second, `rate`. */
  measured(ms, rate, now) {
    const room = this.#pace < 0.9 * this.#display ? 1000 / this.#pace : 0; // ms of all else in a frame, if it shows
    const own = Math.min(1000 / (ms + room), this.#display);
    if (this.#wish === 'here' ? Number.isFinite(ms) : own > GAIN * rate) {
      [this.here, this.#theirs, this.#slow, this.#times] = [true, rate, null, []];
      this.#say(own);
    } else {
      this.#later(now, `the server is faster: ${rate.toFixed(0)} pictures a second, ${own.toFixed(0)} here`);
    }
  }

  /** Count a frame of the display at `now`, ms. */
  frame(now) {
    this.#begun ??= now;
    if (this.rests(now)) { // the rate is not that of which the page is able
      this.#times = [];
      return;
    }
    this.#times.push(now);
    while (this.#times[0] < now - 2000) this.#times.shift();
    const span = now - this.#times[0];
    if (span < 500) return;
    const rate = ((this.#times.length - 1) * 1000) / span;
    if (!this.here) {
      if (rate > this.#display) this.#display = rate; // the fastest rate that was observed
      this.#pace = rate;
      return;
    }
    this.#say(rate);
    if (rate >= SHARE * this.#pace) this.#slow = null;
    else this.#slow ??= now;
    if (this.#wish === 'auto' && this.#slow !== null && now - this.#slow >= PATIENCE) {
      this.#later(now, `this device drew ${rate.toFixed(0)} of ${this.#pace.toFixed(0)} pictures a second`);
    }
  }

  #say(rate) {
    this.reason = `${rate.toFixed(0)} pictures a second here, ${this.#theirs.toFixed(0)} from the server`;
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
