// Watches what the page hands to WebGL, from outside: window.watch. After pixels.js, in one function.
'use strict';

const SQUARE = 16; // pixels of a stamp's square (pictures.py)
const COLUMNS = 6;
const ROWS = 4;

/** uploads: the last pictures put into textures, {id, eye, width, height, ms}; id null: no stamp in it. Set reading to
 * false to measure speed: it makes the page wait for the GPU at every upload. */
const watch = { reading: true, uploads: [], count: 0, opened: 0, closed: 0, violations: [] };

/** frame_id and eye from a stamp's squares, or null. bits[i] is the green value of square i, row by row. */
function readStamp(bits) {
  if (bits.some((value) => value > 80 && value < 175)) return null;
  const value = bits.reduce((sum, bit, index) => sum + (bit > 127 ? 2 ** index : 0), 0);
  const [id, eye, check] = [value % 2 ** 19, Math.floor(value / 2 ** 19) % 2, Math.floor(value / 2 ** 20)];
  const sum = (id ^ (id >> 4) ^ (id >> 8) ^ (id >> 12) ^ (id >> 16) ^ (5 * eye)) & 15;
  return sum === (check ^ 10) ? { id, eye } : null;
}

function note(gl, attach, x, y, source) {
  const bound = gl.getParameter(gl.READ_FRAMEBUFFER_BINDING);
  const framebuffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, framebuffer);
  attach(gl.READ_FRAMEBUFFER);
  const [width, height] = [COLUMNS * SQUARE, ROWS * SQUARE];
  let found = null;
  if (source.width >= width && source.height >= height) {
    const bytes = readBytes(gl, framebuffer, x, y, width, height);
    const bits = [];
    for (let row = 0; row < ROWS; row++) {
      for (let column = 0; column < COLUMNS; column++) {
        bits.push(bytes[4 * ((row * SQUARE + 8) * width + column * SQUARE + 8) + 1]);
      }
    }
    found = readStamp(bits);
  }
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, bound);
  gl.deleteFramebuffer(framebuffer);
  watch.count += 1;
  watch.uploads.push({
    id: found?.id ?? null, eye: found?.eye ?? null, width: source.width, height: source.height, ms: performance.now(),
  });
  if (watch.uploads.length > 400) watch.uploads.shift();
}

const isPicture = (value) => value instanceof ImageBitmap || value instanceof window.VideoFrame;

/** Wraps an upload; at(arguments) says where in the texture it went. */
function spy(name, target, at) {
  const proto = WebGL2RenderingContext.prototype;
  const original = proto[name];
  proto[name] = function spied(...args) {
    original.apply(this, args);
    const source = args.at(-1);
    if (!watch.reading || !isPicture(source)) return;
    const { x = 0, y = 0, level = 0, layer = null } = at(args);
    note(this, (where) => {
      const texture = this.getParameter(this[target]);
      const from = this.COLOR_ATTACHMENT0;
      if (layer === null) this.framebufferTexture2D(where, from, this.TEXTURE_2D, texture, level);
      else this.framebufferTextureLayer(where, from, texture, level, layer);
    }, x, y, source);
  };
}

spy('texImage2D', 'TEXTURE_BINDING_2D', (a) => ({ level: a[1] }));
spy('texSubImage2D', 'TEXTURE_BINDING_2D', (a) => ({ level: a[1], x: a[2], y: a[3] }));
spy('texImage3D', 'TEXTURE_BINDING_2D_ARRAY', (a) => ({ level: a[1], layer: 0 }));
spy('texSubImage3D', 'TEXTURE_BINDING_2D_ARRAY', (a) => ({ level: a[1], x: a[2], y: a[3], layer: a[4] }));

/** Counts the bitmaps that a worker hands over. */
function countBitmaps(value, depth = 0) {
  if (value instanceof ImageBitmap) watch.opened += 1;
  else if (value && typeof value === 'object' && depth < 4) Object.values(value).forEach((v) => countBitmaps(v, depth + 1));
}
const NativeWorker = window.Worker;
window.Worker = class Worker extends NativeWorker {
  constructor(...args) {
    super(...args);
    this.addEventListener('message', (event) => countBitmaps(event.data));
  }
};
const createBitmap = window.createImageBitmap;
window.createImageBitmap = async (...args) => {
  const bitmap = await createBitmap(...args);
  watch.opened += 1;
  return bitmap;
};
const close = ImageBitmap.prototype.close;
ImageBitmap.prototype.close = function counted() {
  if (this.width > 0) watch.closed += 1; // a closed one has no size
  close.call(this);
};
document.addEventListener('securitypolicyviolation', ({ violatedDirective, blockedURI }) =>
  watch.violations.push(`${violatedDirective} ${blockedURI}`));
Object.defineProperty(window, 'watch', { value: watch });
