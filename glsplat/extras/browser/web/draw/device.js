// What this browser and its GPU can do for drawing avatars here; whatever is missing is a sentence.

import { KINDS } from './layers.js';

const WIDEST = 6144; // texels of a row: SH of degree 3 (arena.glsl), and 4096 of the records
const SOFTWARE = /llvmpipe|softpipe|swiftshader|basic render|software/i;

/** {why: '' or a sentence, kinds: of layers that can be blended into, best first, software, renderer} of a context. */
export function look(gl) {
  if (!gl) return nothing('this browser has no WebGL 2');
  for (const name of ['EXT_color_buffer_float', 'EXT_float_blend', 'EXT_color_buffer_half_float']) gl.getExtension(name);
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  const renderer = `${gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER)}`;
  if (gl.getParameter(gl.MAX_TEXTURE_SIZE) < WIDEST) return nothing(`textures of this device have at most ${gl.getParameter(gl.MAX_TEXTURE_SIZE)} texels a side`);
  if (!unpacks()) return nothing('this browser cannot unpack avatars (DecompressionStream)');
  const kinds = ['16f', '8'].filter((kind) => complete(gl, gl[KINDS[kind]]));
  return { why: kinds.length ? '' : 'this device cannot blend into textures', kinds, software: SOFTWARE.test(renderer), renderer };
}

const nothing = (why) => ({ why, kinds: [], software: false, renderer: '' });

function unpacks() {
  try {
    return Boolean(new DecompressionStream('deflate-raw'));
  } catch {
    return false;
  }
}

function complete(gl, format) {
  const [texture, framebuffer] = [gl.createTexture(), gl.createFramebuffer()];
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, 4, 4);
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  const whole = gl.checkFramebufferStatus(gl.FRAMEBUFFER) === gl.FRAMEBUFFER_COMPLETE;
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.deleteFramebuffer(framebuffer);
  gl.deleteTexture(texture);
  return whole;
}

/** Milliseconds that `draw(framebuffer)` takes for pictures of width x height, until they are there: the best of some. */
export function timed(gl, width, height, draw, times = 3) {
  const [texture, framebuffer, pixel] = [gl.createTexture(), gl.createFramebuffer(), new Uint8Array(4)];
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, width, height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  let best = Infinity;
  for (let i = 0; i <= times; i++) {
    const begun = performance.now();
    draw(framebuffer);
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel); // finish() does not wait in every browser
    if (i > 0) best = Math.min(best, performance.now() - begun); // the first one compiles
  }
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.deleteFramebuffer(framebuffer);
  gl.deleteTexture(texture);
  return best;
}
