// What the tests of draw/ run in a page: things by address, pictures as floats in base64.

import { Skeleton, quaternionOf } from '/vr/draw/bones.js';
import { Drawing } from '/vr/draw/drawing.js';
import { cameraOfFile } from '/vr/draw/frame.js';

const TYPES = { float32: Float32Array, uint16: Uint16Array, uint32: Uint32Array };

export async function load(name) {
  const header = await (await fetch(`/vr/data/${name}.json`)).json();
  const body = await (await fetch(`/vr/data/${name}.bin`)).arrayBuffer();
  const arrays = Object.entries(header.arrays).map(([key, [type, at, size]]) => [key, new TYPES[type](body, at, size)]);
  const { skeleton, shapes, ...splats } = { ...header, ...Object.fromEntries(arrays) };
  if (shapes) splats.shapes = { ...shapes, starts: splats.starts, texels: splats.texels };
  return { splats, skeleton: skeleton && new Skeleton(skeleton) };
}

export function poseOf({ vectors, root, translations }) {
  const joints = new Float64Array((vectors.length / 3) * 4);
  for (let j = 0; 3 * j < vectors.length; j++) quaternionOf(vectors, 3 * j, joints, 4 * j);
  return { joints, root, translations };
}

export function context(width = 16, height = 16) {
  const canvas = document.createElement('canvas');
  [canvas.width, canvas.height] = [width, height];
  const gl = canvas.getContext('webgl2', { antialias: false, alpha: true, preserveDrawingBuffer: true });
  gl.getExtension('EXT_color_buffer_float');
  gl.getExtension('EXT_float_blend');
  gl.getExtension('EXT_color_buffer_half_float');
  return gl;
}

const base64 = (bytes) => {
  let text = '';
  for (let i = 0; i < bytes.length; i += 0x8000) text += String.fromCharCode(...bytes.subarray(i, i + 0x8000));
  return btoa(text);
};

/** Layers of the kinds, as floats, rows as they lie; `upward` draws with rows from below and turns them here. */
export async function pictures({ things, poses, cameras, kinds, triangle = false, upward = false }) {
  const table = await (await fetch('/vr/draw/programs.json')).json();
  const gl = context();
  const drawing = new Drawing(gl, table, { triangle });
  const loaded = await Promise.all(things.map(load));
  drawing.show(loaded);
  poses.forEach(({ pose, place, amounts }, i) =>
    drawing.pose(i, { pose: pose && poseOf(pose), ...(place ? { place } : {}), amounts: amounts ? new Float32Array(amounts) : null }));
  const taken = cameras.map(cameraOfFile);
  const out = {};
  for (const kind of kinds) {
    drawing.prepare(taken, upward);
    drawing.drawLayers(taken, kind);
    const { width, height } = cameras[0];
    const floats = new Float32Array(taken.length * width * height * 4);
    drawing.layers.framebuffers.forEach((one, i) => {
      gl.bindFramebuffer(gl.FRAMEBUFFER, one);
      const part = floats.subarray(i * width * height * 4, (i + 1) * width * height * 4);
      if (kind === '8') {
        const bytes = new Uint8Array(part.length);
        gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
        for (let k = 0; k < bytes.length; k++) part[k] = bytes[k] / 255;
      } else gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, part);
    });
    out[kind] = base64(new Uint8Array(floats.buffer));
  }
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  const result = { error: gl.getError(), renderer: gl.getParameter(info.UNMASKED_RENDERER_WEBGL), drawn: drawing.drawn, ...out };
  drawing.release();
  gl.getExtension('WEBGL_lose_context').loseContext();
  return result;
}
