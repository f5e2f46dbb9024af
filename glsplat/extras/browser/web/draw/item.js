// One item's splats on the GPU, and the pass that writes them posed. Twins: glsplat/renderer/stage.py, skin.py.

import { rigid } from './bones.js';
import { bind, buffer, feedback, texture, vertexArray } from './gpu.js';

const STATIC = 11; // floats: mean 3, opacity, quaternion wxyz, scale 3
const SHAPE_ROW = 1024; // entries of shapes a row (shapes.glsl)
const POSED_BYTES = 64;

/**
 * `splats`: {count, means [3 N], quats [4 N] wxyz, scales [3 N], opacities [N], sh [3 K N], degree, antialias, and with
 * a skin joints [k N], weights [k N], influences k and shapes (blob.js)}.
 */
export class Item {
  #gl;
  #programs;
  #arrays = new Map(); // by program's name
  #buffers = [];
  #textures = [];

  constructor(gl, programs, splats, joints) {
    this.#gl = gl;
    this.#programs = programs;
    this.splats = splats;
    const { table } = programs;
    this.rowSize = 1 << table.row_bits;
    this.rows = Math.max(1, Math.ceil(splats.count / this.rowSize));
    this.posed = this.#own(this.rows * this.rowSize * POSED_BYTES, gl.DYNAMIC_COPY);
    if (splats.joints) {
      this.static = this.#own(staticsOf(splats, STATIC), gl.STATIC_DRAW);
      this.joints = this.#own(splats.joints, gl.STATIC_DRAW);
      this.weights = this.#own(splats.weights, gl.STATIC_DRAW);
      this.bones = this.#texture('RGBA32F', 3, joints);
      if (splats.shapes) this.#stageShapes(splats.shapes);
    } else {
      const data = new Float32Array(this.rows * this.rowSize * 12);
      data.set(staticsOf(splats, 12));
      this.rest = this.#texture('RGBA32F', this.rowSize * 3, this.rows, data);
    }
  }

  /**
   * Write `posed`: `bones` [J, 12] placed, or for splats without a skeleton `place` (12 numbers); `amounts`: of the
   * shapes, or null; `sign`: -1 where only some of a scene ask for opacity compensation and this one does.
   */
  pose({ bones, place, size, opacity, amounts }, { turned, sign }) {
    const gl = this.#gl;
    const { units } = this.#programs.table;
    const shaped = Boolean(amounts && this.entries);
    const name = this.splats.joints ? `skin ${this.splats.influences} ${+turned} ${+shaped}` : 'place';
    const program = this.#programs.get(name);
    program.use();
    if (this.splats.joints) {
      bind(gl, units.bones, this.bones);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 3, bones.length / 12, gl.RGBA, gl.FLOAT, new Float32Array(bones));
      gl.uniform1f(program.at.shift ?? null, rigid(bones) ? 1 : 3);
      if (shaped) {
        bind(gl, units.entries, this.entries);
        bind(gl, units.amounts, this.amounts);
        gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, amounts.length / 2, 1, gl.RG, gl.FLOAT, amounts);
      }
    } else {
      bind(gl, units.splats, this.rest);
      const [a, b, c, x, d, e, f, y, g, h, i, z] = place;
      gl.uniformMatrix3fv(program.at.turn, false, [a, d, g, b, e, h, c, f, i]);
      gl.uniform3fv(program.at.rodrigues ?? null, rodriguesOf([a, b, c, d, e, f, g, h, i]));
      gl.uniform3f(program.at.offset, size * x, size * y, size * z);
    }
    gl.uniform1f(program.at.size, size);
    gl.uniform1f(program.at.signed_opacity, sign * opacity);
    feedback(gl, program, this.#array(name, program), this.posed, this.splats.count);
  }

  release() {
    const gl = this.#gl;
    this.#buffers.forEach((one) => gl.deleteBuffer(one));
    this.#textures.forEach((one) => gl.deleteTexture(one));
    this.#arrays.forEach((one) => gl.deleteVertexArray(one));
    this.#arrays.clear();
  }

  #own(data, usage) {
    this.#buffers.push(buffer(this.#gl, data, usage));
    return this.#buffers.at(-1);
  }

  #texture(...what) {
    this.#textures.push(texture(this.#gl, ...what));
    return this.#textures.at(-1);
  }

  #stageShapes({ starts, texels, sizes }) {
    const rows = Math.max(1, Math.ceil(texels.length / 4 / SHAPE_ROW));
    const padded = new Uint32Array(rows * SHAPE_ROW * 4);
    padded.set(texels);
    this.entries = this.#texture('RGBA32UI', SHAPE_ROW, rows, padded);
    this.amounts = this.#texture('RG32F', sizes.length, 1);
    const ranges = new Uint32Array(2 * this.splats.count);
    for (let i = 0; i < this.splats.count; i++) [ranges[2 * i], ranges[2 * i + 1]] = [starts[i], starts[i + 1]];
    this.ranges = this.#own(ranges, this.#gl.STATIC_DRAW);
  }

  #array(name, { attributes: at }) {
    const gl = this.#gl;
    if (this.#arrays.has(name)) return this.#arrays.get(name);
    const from = (location, size, offset) => ({ location, buffer: this.static, size, stride: 4 * STATIC, offset });
    const k = this.splats.influences;
    const parts = k === 8 ? [4, 4] : [k];
    const content = [from(at.mean_opacity, 4, 0), from(at.quat, 4, 16), from(at.scale, 3, 32)];
    parts.forEach((size, i) => {
      const more = { size, stride: 0 };
      content.push({ ...more, location: at[`joints${i}`], buffer: this.joints, type: gl.UNSIGNED_SHORT, stride: 2 * k, offset: 8 * i });
      content.push({ ...more, location: at[`weights${i}`], buffer: this.weights, stride: 4 * k, offset: 16 * i });
    });
    content.push({ location: at.range, buffer: this.ranges, size: 2, type: gl.UNSIGNED_INT });
    this.#arrays.set(name, vertexArray(gl, this.splats.joints ? content : []));
    return this.#arrays.get(name);
  }
}

/** Rows of mean, opacity, quaternion and scale, `stride` floats each. */
function staticsOf({ count, means, quats, scales, opacities }, stride) {
  const out = new Float32Array(stride * count);
  for (let i = 0, at = 0; i < count; i++, at += stride) {
    out.set([means[3 * i], means[3 * i + 1], means[3 * i + 2], opacities[i]], at);
    out.set([quats[4 * i], quats[4 * i + 1], quats[4 * i + 2], quats[4 * i + 3]], at + 4);
    out.set([scales[3 * i], scales[3 * i + 1], scales[3 * i + 2]], at + 8);
  }
  return out;
}

/** Modified Rodrigues parameters, tan(angle / 4) times the axis, of a rotation, row by row. */
function rodriguesOf(m) {
  const w = Math.sqrt(Math.max(0, 1 + m[0] + m[4] + m[8])) / 2;
  if (w > 1e-3) return [m[7] - m[5], m[2] - m[6], m[3] - m[1]].map((v) => v / (4 * w * (1 + w)));
  // half a turn: the axis is the largest column of the rotation plus one
  const columns = [0, 1, 2].map((c) => [0, 1, 2].map((row) => m[3 * row + c] + (row === c ? 1 : 0)));
  const axis = columns.reduce((a, b) => (Math.hypot(...a) >= Math.hypot(...b) ? a : b));
  const size = Math.hypot(...axis);
  return axis.map((v) => v / size);
}

