// Drawing on this device for a page: fetches the programs once, chooses the best kind of layers that is fast enough,
// and creates everything again after a lost context.

import { Crowd } from './crowd.js';
import { look, timed } from './device.js';

const SHARE = 0.8; // of a display's frame; a device that is slower with 16-bit layers blends without layers

export class Own {
  why = ''; // why this device cannot draw, in words
  kind = ''; // of layers; empty: without layers
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

  /** Load the programs by a function that fetches programs.json. Sets `why` if it fails. */
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

  /** Number of splats of the last picture. */
  get drawn() {
    return this.#crowd?.drawn ?? 0;
  }

  /** People to draw, as of Crowd. */
  set people(people) {
    this.#people = people;
    if (this.#crowd) this.#crowd.people = people;
  }

  get people() {
    return this.#people;
  }

  /** Draw as Crowd.draw does. Return false if it failed: `why` has the reason, and nothing is drawn from then on. */
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

  /** Choose the kind of layers for a display, Hz. Return the milliseconds of a picture; Infinity if it fails. */
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

  /** Drop all objects of a lost context. */
  lost() {
    this.#crowd = null;
  }

  /** Use the restored context. */
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
