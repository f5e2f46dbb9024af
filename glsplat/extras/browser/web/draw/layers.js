// Layers that splats are blended into before they are shown, one an eye, and the pass that shows them: in a viewport, or
// behind the glass of a mirror. Twin: glsplat/renderer/targets.py.

import { invert, multiply } from '../space/matrix.js';
import { bind, nearest } from './gpu.js';

/** Kinds of layers, and what a context needs for it (device.js). */
export const KINDS = { 8: 'RGBA8', '16f': 'RGBA16F', '32f': 'RGBA32F' };

const GLASS = `#version 300 es
layout(location = 0) in vec3 position; // of the room, metres
uniform mat4 clip_from_room;
void main() { gl_Position = clip_from_room * vec4(position, 1.0); }
`;

export class Layers {
  framebuffers = [];
  #gl;
  #programs;
  #texture = null;
  #made = '';
  #empty;
  #quad;
  #corners;

  constructor(gl, programs) {
    this.#gl = gl;
    this.#programs = programs;
    this.#empty = gl.createVertexArray();
    this.#quad = gl.createVertexArray();
    this.#corners = gl.createBuffer();
    gl.bindVertexArray(this.#quad);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#corners);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 12, 0);
    gl.bindVertexArray(null);
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
  }

  /** Have `views` layers of width x height of a kind. Throws where the device cannot. */
  fit(kind, width, height, views) {
    const key = `${kind} ${width} ${height} ${views}`;
    if (key === this.#made) return;
    this.#drop();
    const gl = this.#gl;
    this.#texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.#texture);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl[KINDS[kind]], width, height, views);
    nearest(gl, gl.TEXTURE_2D_ARRAY);
    for (let i = 0; i < views; i++) {
      this.framebuffers.push(gl.createFramebuffer());
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffers[i]);
      gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, this.#texture, 0, i);
    }
    const status = gl.checkFramebufferStatus(gl.FRAMEBUFFER);
    if (status !== gl.FRAMEBUFFER_COMPLETE && !gl.isContextLost()) {
      this.#drop();
      throw new Error(`this device cannot blend into pictures of the kind ${kind}`);
    }
    this.#made = key;
  }

  /** Put the layers over what `framebuffer` has: all over each eye's viewport, or where its mirror's glass is. */
  resolve(eyes, framebuffer, glass) {
    const gl = this.#gl;
    const program = this.#programs.get('resolve', glass ? GLASS : null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    program.use();
    bind(gl, this.#programs.table.units.target, this.#texture, gl.TEXTURE_2D_ARRAY);
    gl.bindVertexArray(glass ? this.#quad : this.#empty);
    if (glass) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.#corners);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([glass[3], glass[2], glass[0], glass[1]].flat()), gl.STREAM_DRAW);
      gl.bindBuffer(gl.ARRAY_BUFFER, null);
    }
    eyes.forEach(({ transform, projection, viewport: { x, y, width, height } }, i) => {
      gl.viewport(x, y, width, height);
      gl.uniform3i(program.at.view, i, x, y);
      if (glass) gl.uniformMatrix4fv(program.at.clip_from_room, false, new Float32Array(multiply(projection, invert(transform))));
      gl.drawArrays(glass ? gl.TRIANGLE_STRIP : gl.TRIANGLES, 0, glass ? 4 : 3);
    });
    gl.bindVertexArray(null);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, null);
  }

  release() {
    this.#drop();
    this.#gl.deleteVertexArray(this.#empty);
    this.#gl.deleteVertexArray(this.#quad);
    this.#gl.deleteBuffer(this.#corners);
  }

  #drop() {
    this.framebuffers.forEach((one) => this.#gl.deleteFramebuffer(one));
    this.#gl.deleteTexture(this.#texture);
    [this.framebuffers, this.#texture, this.#made] = [[], null, ''];
  }
}
