// Reading back what WebGL drew, without leaving a trace in the page's state. For the fake headset and for watch.js.
'use strict';

/** A framebuffer [height, width] RGBA with depth; nothing bound changes. */
function makeFramebuffer(gl, width, height, alpha) {
  const kept = [gl.TEXTURE_BINDING_2D, gl.RENDERBUFFER_BINDING, gl.DRAW_FRAMEBUFFER_BINDING, gl.READ_FRAMEBUFFER_BINDING]
    .map((name) => gl.getParameter(name));
  const [texture, depth, framebuffer] = [gl.createTexture(), gl.createRenderbuffer(), gl.createFramebuffer()];
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, alpha ? gl.RGBA8 : gl.RGB8, width, height);
  gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
  gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH24_STENCIL8, width, height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_STENCIL_ATTACHMENT, gl.RENDERBUFFER, depth);
  gl.bindTexture(gl.TEXTURE_2D, kept[0]);
  gl.bindRenderbuffer(gl.RENDERBUFFER, kept[1]);
  gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, kept[2]);
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, kept[3]);
  return framebuffer;
}

/** A headset's layer begins each frame as transparent black. */
function clearLayer({ framebuffer, [INNER]: { gl } }) {
  const [bound, mask, scissor] = [gl.DRAW_FRAMEBUFFER_BINDING, gl.COLOR_WRITEMASK, gl.SCISSOR_TEST]
    .map((name) => gl.getParameter(name));
  const depth = gl.getParameter(gl.DEPTH_WRITEMASK);
  gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, framebuffer);
  gl.colorMask(true, true, true, true);
  gl.depthMask(true);
  gl.disable(gl.SCISSOR_TEST);
  gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
  gl.clearBufferfi(gl.DEPTH_STENCIL, 0, 1, 0);
  gl.colorMask(...mask);
  gl.depthMask(depth);
  if (scissor) gl.enable(gl.SCISSOR_TEST);
  gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, bound);
}

/** Bytes RGBA of a box of a framebuffer (null: the canvas), rows bottom-up. */
function readBytes(gl, framebuffer, x, y, width, height) {
  const [bound, buffer] = [gl.READ_FRAMEBUFFER_BINDING, gl.PIXEL_PACK_BUFFER_BINDING].map((name) => gl.getParameter(name));
  const names = [gl.PACK_ALIGNMENT, gl.PACK_ROW_LENGTH, gl.PACK_SKIP_ROWS, gl.PACK_SKIP_PIXELS];
  const stores = names.map((name) => gl.getParameter(name));
  names.forEach((name, index) => gl.pixelStorei(name, [1, 0, 0, 0][index]));
  gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, framebuffer);
  const out = new Uint8Array(4 * width * height);
  gl.readPixels(x, y, width, height, gl.RGBA, gl.UNSIGNED_BYTE, out);
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, bound);
  gl.bindBuffer(gl.PIXEL_PACK_BUFFER, buffer);
  names.forEach((name, index) => gl.pixelStorei(name, stores[index]));
  return out;
}

/** The same as base64, {width, height, data}. */
function readPixels(gl, framebuffer, x, y, width, height) {
  const bytes = readBytes(gl, framebuffer, x, y, width, height);
  let text = '';
  for (let at = 0; at < bytes.length; at += 0x8000) text += String.fromCharCode(...bytes.subarray(at, at + 0x8000));
  return { width, height, data: btoa(text) };
}
