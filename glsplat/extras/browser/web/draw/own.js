// Drawing on this device, as a page uses it: programs fetched once, the best kind of layers that is fast enough, and all
// of it made anew after a lost context.

import { Crowd } from './crowd.js';
import { look, timed } from './device.js';

const SHARE = 0.8; // of a display's frame that a picture may take in 16-bit layers; else it is blended where it is shown

export class Own {
  why = ''; // why this device cannot draw, in words
  kind = ''; // of layers; empty: none
  #gl;
  #table = null;
  #crowd = null;
  #people = [];
  #device;

  constructor(gl) {
    this.#gl = gl;
    this.#device = look(gl);
    this.why = this.#device.why;
  }

  /** Have the programs, from a function that fetches programs.json. `why` says so where it fails. */
  async open(fetched) {
    if (this.why || this.#table) return !this.why;
    try {
      this.#table = await fetched();
      this.#make();
    } catch (error) {
      this.#fail(error);
    }
    return !this.why;
  }

  get ready() {
    return this.#crowd !== null;
  }

  /** Splats of the last picture. */
  get drawn() {
    return this.#crowd?.drawn ?? 0;
  }

  /** Who is to be seen: as of Crowd. */
  set people(people) {
    this.#people = people;
    if (this.#crowd) this.#crowd.people = people;
  }

  get people() {
    return this.#people;
  }

  /** Draw as Crowd.draw does. Returns false where it failed, which `why` then says; nothing is drawn from then on. */
  draw(...what) {
    if (!this.#crowd) return false;
    try {
      this.#crowd.draw(...what);
      return true;
    } catch (error) {
      if (!this.#gl.isContextLost()) this.#fail(error);
      return false;
    }
  }

  /** Milliseconds a picture takes, after choosing the kind of layers for a display of so many Hz; Infinity if it fails. */
  measure(eyes, shown, hertz) {
    const { width, height } = eyes[0].viewport;
    const views = eyes.map((eye) => ({ ...eye, viewport: { x: 0, y: 0, width, height } }));
    let took = Infinity;
    for (const kind of [...this.#device.kinds.filter((one) => one !== '8'), '']) {
      if (!this.#crowd) return Infinity;
      this.#crowd.drawing.kind = this.kind = kind;
      took = timed(this.#gl, width, height, (framebuffer) => this.draw(views, framebuffer, shown));
      if (took <= (SHARE * 1000) / hertz) break;
    }
    return this.#crowd ? took : Infinity;
  }

  /** The context was lost: nothing of it is left. */
  lost() {
    this.#crowd = null;
  }

  /** It came back. */
  restored() {
    this.#device = look(this.#gl);
    this.why = this.#device.why;
    try {
      if (this.#table && !this.why) this.#make();
    } catch (error) {
      this.#fail(error);
    }
  }

  #make() {
    this.#crowd = new Crowd(this.#gl, this.#table, { triangle: this.#device.software, kind: this.kind });
    this.#crowd.people = this.#people;
  }

  #fail(error) {
    this.why = `this device cannot draw avatars: ${`${error.message}`.slice(0, 200)}`;
    this.#crowd?.release();
    this.#crowd = null;
  }
}
