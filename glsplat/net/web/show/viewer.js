// The page without a headset: the avatar on the canvas, seen by an eye (or two) that goes around it.

import { IDENTITY } from '../space/matrix.js';

const DENSEST = 2; // canvas pixels a CSS pixel
const KEEP = 1000; // ms between requests while nothing moves
const SLOWEST = 100; // ms between frames, at most
const APART = 8; // ms between two requests at least, where one does not wait for the next frame
const RESTING = 1500; // ms between frames while others need the machine

const HERE = Object.freeze({ view: 'viewer', shown: IDENTITY, mirror: false, glass: null });
const IN_ROOM = Object.freeze({ ...HERE, whole: true });

export class Viewer {
  #canvas;
  #stage;
  #orbit;
  #settings;
  #adds;
  #driver = null;
  #last = ''; // what was asked last
  #asked = 0; // ms
  #drawn = 0; // ms
  #handle = 0; // of the next frame of the display, or of the last while some are left out; 0: stopped
  #timer = 0; // while frames are left out
  covered = () => ({ top: 0, right: 0, bottom: 0, left: 0 }); // CSS pixels of the canvas that something lies over
  rests = () => false; // whether others need the machine: then it draws and asks now and then
  ready = () => true; // whether it is known by now what moves the avatar
  onDrive = () => {}; // hears of what moves the avatar, every frame
  onAsked = () => {}; // hears that what `adds` made of it last has gone out

  /** `adds(drive)` is what is sent of what the driver says. */
  constructor(canvas, stage, orbit, settings, adds = (drive) => drive) {
    this.#canvas = canvas;
    this.#stage = stage;
    this.#orbit = orbit;
    this.#settings = settings;
    this.#adds = adds;
    stage.onPicture = () => this.wake();
    for (const type of ['pointermove', 'wheel', 'keydown']) canvas.addEventListener(type, () => this.wake());
  }

  /** Who poses the avatar (track/drivers.js). All go by one clock, so that the server's filters see no leap back. */
  get driver() {
    return this.#driver;
  }

  set driver(driver) {
    this.#driver = driver;
    this.#stage.framing.forget();
  }

  start() {
    this.stop();
    this.#handle = requestAnimationFrame((now) => this.#frame(now));
  }

  stop() {
    cancelAnimationFrame(this.#handle);
    clearTimeout(this.#timer);
    [this.#handle, this.#timer] = [0, 0];
  }

  /** Draw at the next frame of the display, if it was to be left out. */
  wake() {
    if (this.#timer) this.start();
  }

  #frame(begun) {
    let pause = 0;
    try {
      pause = this.#draw(begun);
    } finally {
      if (this.#handle && pause > 0) this.#timer = setTimeout(() => this.start(), pause);
      else if (this.#handle) this.start();
    }
  }

  /** Draw and request. Return the milliseconds for which frames of the display would show and request nothing new. */
  #draw(begun) {
    const now = Math.max(begun, this.#asked); // a frame may have begun before what was asked between two
    if (this.rests() && now - this.#drawn < RESTING) return SLOWEST;
    this.#drawn = now;
    const { width, height } = this.#fit();
    if (!width || !height) return SLOWEST;
    this.#orbit.inset = this.covered();
    this.#orbit.scale = width / this.#canvas.clientWidth;
    const views = this.#orbit.views(width, height, { stereo: this.#settings.get('stereo') });
    const drive = this.#adds(this.#driver?.at(now / 1000) ?? {});
    this.onDrive(drive);
    const seen = [views.map(({ transform, projection }) => [transform, projection]), width, height];
    const lit = [this.#settings.get('place'), this.#settings.get('light')];
    const key = drive.tracking || drive.pose ? '' : JSON.stringify([seen, lit]);
    const room = this.#settings.get('room') !== '';
    const moves = room || key === '' || key !== this.#last || !this.#stage.painter.shownAs.length;
    // the filters of tracking need every frame
    const pause = !moves ? KEEP : drive.tracking ? 0 : this.#stage.pause(now);
    const asks = this.ready() && now - this.#asked >= pause;
    const shown = this.#stage.shownId;
    if (this.#stage.frame(views, room ? IN_ROOM : HERE, drive, { alpha: true, keeps: true, room: true, asks, now })) {
      [this.#last, this.#asked] = [key, now];
      this.onAsked();
    }
    const box = room ? this.#stage.ownBox : this.#stage.info.box;
    if (this.#stage.shownId !== shown && box) this.#orbit.follow(box);
    return drive.tracking || !this.#stage.rests(now) ? 0 : Math.min(SLOWEST, this.#asked + pause - now);
  }

  /** Who speaks is not to wait for the next frame. What is tracked does: its filters want frames' times. */
  askNow(now = performance.now()) {
    const waits = !this.#handle || document.hidden || !this.ready() || this.rests();
    if (waits || now - this.#asked < APART) return;
    const drive = this.#adds(this.#driver?.at(now / 1000) ?? {});
    if (!drive.pose || !this.#stage.askAgain(drive, now)) return;
    this.#asked = now;
    this.onAsked();
  }

  #fit() {
    const density = Math.min(DENSEST, devicePixelRatio || 1);
    const width = Math.round(this.#canvas.clientWidth * density);
    const height = Math.round(this.#canvas.clientHeight * density);
    if (this.#canvas.width !== width || this.#canvas.height !== height) {
      this.#canvas.width = width;
      this.#canvas.height = height;
    }
    return { width, height };
  }
}
