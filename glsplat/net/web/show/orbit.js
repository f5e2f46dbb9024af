// The camera of the flat page: it circles a point by mouse, touch and keys. Room axes: x right, y up, metres.

const FOV = (40 * Math.PI) / 180; // vertical field of view, radians
const SLIM = { person: 0.42, room: 1.1 }; // width by height of a view that they just fit into
const [NEAR, FAR] = [0.05, 100]; // metres
const START = { yaw: 0, pitch: 0.06, distance: 3.4, centre: [0, 0.95, 0] };
const PITCH = 1.48; // radians up and down at most
const DISTANCE = [0.3, 30]; // metres
const PAN = 10; // metres off the avatar at most
const TURN = (5 * Math.PI) / 180; // radians a key press
const STEP = 0.05; // a key press moves by this part of the distance
const ZOOM = 1.1; // a key press changes the distance by this factor
const SLACK = 0.1; // the avatar may be off the middle by this part of the distance before the camera follows
const BACK = 4.9; // metres of the camera from the middle of a room at most: a place has walls at 4.6, and it stands aside of the axis
const FACE = { down: 0.13, distance: 0.85 }; // metres: from the top of the box to the eyes, and away from them
const FOLLOWING = 0.5; // seconds in which the camera makes up most of the rest

/** yaw 0 looks from +z, into the face of an avatar; pitch > 0 looks down. Nothing moves on by itself. */
export class Orbit {
  yaw = START.yaw;
  pitch = START.pitch;
  distance = START.distance;
  inset = { top: 0, right: 0, bottom: 0, left: 0 }; // CSS pixels of the canvas that something covers
  stands = false; // whether it keeps its place although the avatar moves
  close = false; // whether F brought it before the face
  #box = null; // of the avatar, as `follow` was told last
  #seeks = false; // whether the next box is somebody else's, whose face is to be looked at
  #centre = [...START.centre];
  #pan = [0, 0, 0];
  #followed = null; // milliseconds, when follow() was called last
  #home = null; // {yaw, pitch, distance, pan} of a room, instead of START
  walk = null; // in a room: takes strides ahead and to the right, and turns to the left, by the keys
  scale = 1; // pixels of the canvas a CSS pixel
  #pointers = new Map(); // id -> [x, y], CSS pixels
  #listening = null;

  /** The point in the middle of the view, [x, y, z]. */
  get target() {
    return this.#centre.map((v, i) => v + this.#pan[i]);
  }

  /** Listen to an element's pointers, wheel and keys (it needs the focus for these). */
  attach(element) {
    this.detach();
    this.#listening = new AbortController();
    const { signal } = this.#listening;
    const on = (type, listener, options = {}) => element.addEventListener(type, listener, { ...options, signal });
    on('pointerdown', (event) => this.#down(event, element));
    on('pointermove', (event) => this.#move(event, element));
    for (const type of ['pointerup', 'pointercancel', 'lostpointercapture']) {
      on(type, (event) => this.#pointers.delete(event.pointerId));
    }
    on('contextmenu', (event) => event.preventDefault()); // the right button pans
    on('wheel', (event) => this.#wheel(event, element), { passive: false });
    on('keydown', (event) => this.#key(event));
  }

  /** Stop listening. */
  detach() {
    this.#listening?.abort();
    this.#listening = null;
    this.#pointers.clear();
  }

  /** Back to the start: in front of the avatar, or behind it in a room. */
  reset() {
    const { yaw, pitch, distance, pan = [0, 0, 0] } = this.#home ?? START;
    Object.assign(this, { yaw, pitch, distance, close: false, stands: this.#home !== null });
    this.#pan = [...pan];
    this.#followed = null;
  }

  /** Before the face; once there, back to the start. */
  toggleFace() {
    const { close } = this;
    this.reset();
    if (!close && this.#box) this.#face();
  }

  /** Somebody else is seen from the next `follow` on: a face that is looked at is theirs. */
  changed() {
    this.#seeks = this.close;
  }

  #face() {
    const [x0, , z0, x1, top, z1] = this.#box;
    this.#pan = [(x0 + x1) / 2, top - FACE.down, (z0 + z1) / 2].map((v, i) => v - this.#centre[i]);
    [this.distance, this.pitch, this.close] = [FACE.distance, 0, true];
    this.yaw = this.#home?.front ?? START.yaw;
    this.#followed = 0; // the middle of the box is no longer what is looked at first
  }

  /** Stand for a room: everybody in sight, from over the user's shoulder. */
  standBack(middle, radius) {
    const pan = middle.map((v, i) => v - this.#centre[i]);
    this.#home = { yaw: 2.75, pitch: 0.2, distance: Math.min(BACK, 2.6 + 2.2 * radius), pan, front: 0 };
    this.#box = null;
    this.reset();
  }

  /** Move along with the user, who looks along `front` (radians) now. */
  goAlong(by, front) {
    this.#pan = this.#pan.map((v, i) => v + by[i]);
    if (this.#home) Object.assign(this.#home, { front, pan: this.#home.pan.map((v, i) => v + by[i]) });
  }

  /** Leave a room. */
  standAlone() {
    [this.#home, this.walk] = [null, null];
    this.reset();
  }

  /** Circle by radians. */
  turn(yaw, pitch) {
    this.yaw = (this.yaw + yaw) % (2 * Math.PI);
    this.pitch = clamp(this.pitch + pitch, -PITCH, PITCH);
  }

  /** Change the distance by a factor; what lies `at` [right, up] metres off the target, in its plane, stays where it is seen. */
  zoom(factor, at = [0, 0]) {
    const before = this.distance;
    this.distance = clamp(before * factor, ...DISTANCE);
    const part = 1 - this.distance / before;
    if (at[0] || at[1]) this.pan(part * at[0], part * at[1]);
  }

  /** Move the target by metres along the camera's right, its up, and level ahead. */
  pan(right, up, ahead = 0) {
    const axes = this.#axes();
    const level = [-Math.sin(this.yaw), 0, -Math.cos(this.yaw)];
    const moved = (i) => this.#pan[i] + right * axes.right[i] + up * axes.up[i] + ahead * level[i];
    this.#pan = [0, 1, 2].map((i) => clamp(moved(i), -PAN, PAN));
  }

  /** Keep an avatar's box [x0, y0, z0, x1, y1, z1] in view: at once the first time, gently from then on. */
  follow(box, nowMs = performance.now()) {
    if (!box?.every(Number.isFinite)) return;
    this.#box = [...box];
    if (this.#seeks) this.#face();
    this.#seeks = false;
    if (this.close || this.stands) return; // a face is not lost for an arm that is raised
    const off = [0, 1, 2].map((i) => (box[i] + box[i + 3]) / 2 - this.#centre[i]);
    const far = Math.hypot(...off);
    const excess = Math.max(far - SLACK * this.distance, 0);
    const seconds = this.#followed === null ? Infinity : Math.max(nowMs - this.#followed, 0) / 1000;
    const part = seconds === Infinity ? 1 : ((1 - Math.exp(-seconds / FOLLOWING)) * excess) / (far || 1);
    this.#centre = this.#centre.map((v, i) => v + part * off[i]);
    this.#followed = nowMs;
  }

  /**
   * The eyes for a canvas of width x height pixels: one, or two side by side with parallel axes, `ipd` metres apart.
   * [{eye, transform: room from camera, projection, viewport: {x, y, width, height}}], matrices column by column.
   */
  views(width, height, { stereo = false, ipd = 0.063 } = {}) {
    if (!stereo) return [this.#view('none', 0, { x: 0, y: 0, width, height })];
    const half = Math.max(Math.floor(width / 2), 1);
    return [
      this.#view('left', -ipd / 2, { x: 0, y: 0, width: half, height }),
      this.#view('right', ipd / 2, { x: half, y: 0, width: half, height }),
    ];
  }

  #view(eye, aside, viewport) {
    const { right, up, back } = this.#axes();
    const place = this.target.map((v, i) => v + this.distance * back[i] + aside * right[i]);
    const transform = [...right, 0, ...up, 0, ...back, 0, ...place, 1];
    return { eye, transform, projection: projection(viewport, this.#free(viewport), this.#home ? SLIM.room : SLIM.person), viewport };
  }

  /** The part of a viewport that nothing covers, of 1: {x, y (of its middle, up), width, height}. */
  #free({ width, height }) {
    const scale = this.scale;
    const { top, right, bottom, left } = this.inset;
    const part = (a, b, whole) => Math.max(0.3, 1 - (scale * (a + b)) / Math.max(whole, 1));
    const shift = (a, b, whole) => clamp((scale * (a - b)) / Math.max(whole, 1), -0.7, 0.7);
    return { x: shift(left, right, width), y: shift(bottom, top, height), width: part(left, right, width), height: part(top, bottom, height) };
  }

  /** [right, up] in metres of a pointer from the target, in the plane that it lies in. */
  #under(event, element) {
    const box = element.getBoundingClientRect();
    const [width, height] = [Math.max(box.width, 1), Math.max(box.height, 1)];
    const { projection: p } = this.#view('none', 0, { x: 0, y: 0, width: width * this.scale, height: height * this.scale });
    const x = ((event.clientX - box.left) / width) * 2 - 1;
    const y = 1 - ((event.clientY - box.top) / height) * 2;
    return [((x + p[8]) / p[0]) * this.distance, ((y + p[9]) / p[5]) * this.distance];
  }

  /** The camera's axes in the room; it looks along -back. */
  #axes() {
    const [sy, cy, sp, cp] = [Math.sin(this.yaw), Math.cos(this.yaw), Math.sin(this.pitch), Math.cos(this.pitch)];
    return { right: [cy, 0, -sy], up: [-sy * sp, cp, -cy * sp], back: [sy * cp, sp, cy * cp] };
  }

  #down(event, element) {
    if (this.#pointers.size >= 2) return; // a third finger is none of ours
    element.focus({ preventScroll: true });
    element.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  #move(event, element) {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    this.#pointers.set(event.pointerId, now);
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    const height = Math.max(element.clientHeight, 1);
    const other = [...this.#pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const apart = (a) => Math.max(Math.hypot(a[0] - other[0], a[1] - other[1]), 1);
      const middle = { clientX: (before[0] + other[0]) / 2, clientY: (before[1] + other[1]) / 2 };
      this.zoom(apart(before) / apart(now), this.#under(middle, element));
      this.#drag(dx / 2, dy / 2, height); // the middle of two fingers moves half as far as one of them
    } else if (event.pointerType === 'mouse' && (event.buttons & 6) !== 0) {
      this.#drag(dx, dy, height);
    } else {
      this.turn((-Math.PI * dx) / height, (Math.PI * dy) / height);
    }
  }

  /** Pan so that the target stays under the pointer that was dragged by dx, dy pixels. */
  #drag(dx, dy, height) {
    const metres = (2 * this.distance * Math.tan(FOV / 2)) / height;
    this.pan(-dx * metres, dy * metres);
  }

  #wheel(event, element) {
    event.preventDefault();
    const unit = [1, 16, element.clientHeight][event.deltaMode] ?? 1; // pixels, lines, pages
    const pixels = clamp(event.deltaY * unit, -200, 200);
    this.zoom(Math.exp(pixels * (event.ctrlKey ? 0.01 : 0.0015)), this.#under(event, element)); // ctrl: a pinch on a touch pad
  }

  #key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const step = STEP * this.distance;
    const actions = {
      arrowleft: () => this.turn(-TURN, 0),
      arrowright: () => this.turn(TURN, 0),
      arrowup: () => this.turn(0, TURN),
      arrowdown: () => this.turn(0, -TURN),
      '+': () => this.zoom(1 / ZOOM),
      '=': () => this.zoom(1 / ZOOM),
      '-': () => this.zoom(ZOOM),
      a: () => this.pan(-step, 0),
      d: () => this.pan(step, 0),
      w: () => this.pan(0, 0, step),
      s: () => this.pan(0, 0, -step),
      q: () => this.pan(0, -step),
      e: () => this.pan(0, step),
      f: () => this.toggleFace(),
      r: () => this.reset(),
    };
    const { walk } = this;
    const ways = walk && { w: () => walk(1, 0, 0), s: () => walk(-1, 0, 0), a: () => walk(0, -1, 0), d: () => walk(0, 1, 0), q: () => walk(0, 0, 1), e: () => walk(0, 0, -1) };
    Object.assign(actions, ways);
    const key = event.key.toLowerCase();
    if (!Object.hasOwn(actions, key)) return;
    actions[key]();
    event.preventDefault();
  }
}

/** An OpenGL projection whose middle is that of the free part of a viewport, which FOV fills, in its width what is as `slim`. */
function projection({ width, height }, free, slim) {
  const aspect = Math.max(width, 1) / Math.max(height, 1);
  const f = free.height / Math.tan(FOV / 2);
  const narrow = Math.min(1, (aspect * free.width) / free.height / slim);
  const [a, b] = [(FAR + NEAR) / (NEAR - FAR), (2 * FAR * NEAR) / (NEAR - FAR)];
  return [(f * narrow) / aspect, 0, 0, 0, 0, f * narrow, 0, 0, -free.x, -free.y, a, -1, 0, 0, b, 0];
}

function clamp(value, least, most) {
  return Math.min(Math.max(value, least), most);
}
