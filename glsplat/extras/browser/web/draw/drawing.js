// The frame: posed splats into the arena, one order of all, one record a splat, one draw an eye. Twins:
// glsplat/renderer/arena.py and pipeline.py. Works on any WebGL2 context; knows no page and no headset.

import { HERE, movedMeans, placed } from './bones.js';
import { cameraOf, fillSurfaces, frameBlock, sortRow, uniformsOf } from './frame.js';
import { bind, buffer, copyRows, feedback, texture, vertexArray } from './gpu.js';
import { Item } from './item.js';
import { Layers } from './layers.js';
import { Order } from './order.js';
import { Programs } from './programs.js';

const MOST_VIEWS = 2; // of a pass; some headsets have four
const RECORD_ROW = 4096; // floats a row of the records' texture (record_input.glsl)
const STILL = Float64Array.of(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0);

/**
 * `triangle`: one triangle a splat instead of a quad, which is what a CPU wants. `kind`: '' blends into the bound
 * framebuffer itself, '8', '16f' or '32f' into layers of that kind first (layers.js).
 */
export class Drawing {
  drawn = 0; // splats of the last frame
  light = null; // {ambient, sun} of frame.js that falls on all that knows its surface
  #gl;
  #programs;
  #order = new Order();
  #shown = []; // [{splats, item, first, means, bones, place, size, opacity, amounts, moved}]
  #arena = null; // {degree, antialias, posed, colours, rows, surfaced, surfaces: made when light first falls}
  #frame = null; // {count, views, lit, order, records, texture, array, block}
  #layers;
  #empty;

  constructor(gl, table, { triangle = false, kind = '' } = {}) {
    this.#gl = gl;
    this.#programs = new Programs(gl, table);
    this.#layers = new Layers(gl, this.#programs);
    this.#empty = gl.createVertexArray();
    this.block = buffer(gl, 16 * 32, gl.DYNAMIC_DRAW);
    Object.assign(this, { triangle, kind });
  }

  get programs() {
    return this.#programs;
  }

  get layers() {
    return this.#layers;
  }

  /** Show these, in their order: [{splats, skeleton (of bones.js) or null}]. What was shown and is so no more is released. */
  show(things) {
    const before = this.#shown;
    this.#shown = things.map(({ splats, skeleton = null }) => {
      const same = before.find((one) => one.splats === splats && one.skeleton === skeleton && !one.taken);
      if (same) same.taken = true;
      const item = same?.item ?? new Item(this.#gl, this.#programs, splats, skeleton?.count ?? 0);
      const rest = { place: STILL, size: 1, opacity: 1, amounts: null, bones: null, means: splats.means };
      return { ...rest, ...same, splats, skeleton, item, moved: true, taken: false };
    });
    for (const one of before) if (!one.taken) one.item.release();
    this.#stage();
  }

  /**
   * Pose thing number `index`: `bones` [J, 12] of its skeleton (null: it has none), `place` as HERE, `amounts` of its
   * shapes or null, `opacity` 0..1.
   */
  pose(index, { bones = null, place = HERE, amounts = null, opacity = 1 }) {
    const one = this.#shown[index];
    const before = one.skeleton ? one.bones : one.place;
    const stands = one.skeleton ? placed(bones, place, one.spare ?? undefined) : placed(STILL, place);
    const same = before !== null && before.every((v, i) => v === stands[i]);
    const still = same && one.size === place.scale && one.opacity === opacity && !amounts && !one.amounts;
    one.moved ||= !still; // who stands still is not skinned again
    Object.assign(one, { size: place.scale, opacity, amounts });
    if (one.skeleton) [one.bones, one.spare] = [stands, one.bones];
    else one.place = stands;
    const { splats } = one;
    one.means = amounts && splats.shapes ? movedMeans(splats, amounts, one.expressed ?? new Float32Array(splats.means.length)) : splats.means;
    if (one.means !== splats.means) one.expressed = one.means;
  }

  /**
   * Draw for eyes [{transform, projection, viewport}] of one size into `framebuffer`. `shown`: the room that is seen from
   * the room of the things, a reflection for a mirror; `glass`: the mirror's four corners in the room seen.
   */
  draw(eyes, framebuffer, shown, glass = null) {
    for (let i = 0; i < eyes.length; i += MOST_VIEWS) this.#drawPair(eyes.slice(i, i + MOST_VIEWS), framebuffer, shown, glass);
  }

  #drawPair(eyes, framebuffer, shown, glass) {
    const { width, height } = eyes[0].viewport;
    const cameras = eyes.map((eye) => cameraOf(eye, width, height, shown));
    this.prepare(cameras, true);
    const kind = glass && !this.kind ? '8' : this.kind;
    if (!kind) {
      this.drawViews(eyes, framebuffer);
      return;
    }
    this.drawLayers(cameras, kind);
    this.#layers.resolve(eyes, framebuffer, glass);
  }

  /** Up to the records of these cameras (frame.js), which are one or two. `order`: indices of the arena, if not its own. */
  prepare(cameras, upward, order = null) {
    const gl = this.#gl;
    this.#poseMoved();
    const row = sortRow(cameras);
    const sorted = order ?? this.#order.sort(this.#shown.map((one) => ({ ...one, first: one.first * one.item.rowSize })), row);
    this.drawn = sorted.length;
    const frame = this.#work(cameras.length, sorted.length);
    gl.bindBuffer(gl.UNIFORM_BUFFER, this.block);
    gl.bufferData(gl.UNIFORM_BUFFER, frameBlock(cameras, this.#programs.table.knobs, upward), gl.DYNAMIC_DRAW);
    gl.bindBufferBase(gl.UNIFORM_BUFFER, this.#programs.table.frame_block, this.block);
    if (!sorted.length) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, frame.order);
    gl.bufferData(gl.ARRAY_BUFFER, sorted, gl.STREAM_DRAW); // new memory instead of a wait
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
    const { units } = this.#programs.table;
    if (frame.lit) {
      bind(gl, units.surfaces, this.#surfaces());
      frame.project.use();
      gl.uniform4fv(frame.project.at['light[0]'], uniformsOf(this.light));
    }
    bind(gl, units.colours, this.#arena.colours);
    bind(gl, units.splats, this.#arena.posed);
    feedback(gl, frame.project, frame.array, frame.records, sorted.length);
    const rows = Math.ceil((sorted.length * frame.floats) / RECORD_ROW);
    gl.activeTexture(gl.TEXTURE0 + units.records);
    copyRows(gl, frame.records, frame.texture, 'R32F', RECORD_ROW, 0, rows);
  }

  /** Blend what was prepared into the viewports of a framebuffer. */
  drawViews(eyes, framebuffer = null) {
    eyes.forEach(({ viewport }, i) => this.#drawView(i, framebuffer, viewport));
    this.#gl.disable(this.#gl.SCISSOR_TEST);
  }

  /** Blend what was prepared into the layers of a kind, one an eye; they hold the picture. */
  drawLayers(cameras, kind) {
    const { width, height } = cameras[0];
    this.#layers.fit(kind, width, height, cameras.length);
    cameras.forEach((_, i) => this.#drawView(i, this.#layers.framebuffers[i], { x: 0, y: 0, width, height }, true));
    this.#gl.disable(this.#gl.SCISSOR_TEST);
  }

  release() {
    this.show([]);
    this.#dropWork();
    this.#layers.release();
    this.#gl.deleteVertexArray(this.#empty);
    this.#gl.deleteBuffer(this.block);
    this.#programs.release();
  }

  #drawView(view, framebuffer, { x, y, width, height }, clear = false) {
    const gl = this.#gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(x, y, width, height);
    gl.enable(gl.SCISSOR_TEST); // a splat at the rim of one eye does not reach into the other's half
    gl.scissor(x, y, width, height);
    if (clear) {
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT);
    }
    if (!this.drawn) return;
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const { draw, texture: records } = this.#frame;
    draw.use();
    if (draw.at.eye) gl.uniform1i(draw.at.eye, view);
    bind(gl, this.#programs.table.units.records, records);
    gl.bindVertexArray(this.#empty);
    gl.drawArrays(gl.TRIANGLES, 0, this.drawn * (this.triangle ? 3 : 6));
    gl.bindVertexArray(null);
  }

  #poseMoved() {
    const [gl, arena] = [this.#gl, this.#arena];
    for (const one of this.#shown) {
      if (!one.moved) continue;
      one.moved = false;
      one.item.pose(one, { turned: arena.degree > 0, sign: arena.antialias === 2 && one.splats.antialias ? -1 : 1 });
      gl.activeTexture(gl.TEXTURE0);
      copyRows(gl, one.item.posed, arena.posed, 'RGBA32F', 4 * one.item.rowSize, one.first, one.item.rows);
    }
  }

  /** The arena of what is shown: rows of each, textures that hold them, their colours. */
  #stage() {
    const [gl, { table }] = [this.#gl, this.#programs];
    if (this.#arena) [this.#arena.posed, this.#arena.colours, this.#arena.surfaces].forEach((one) => gl.deleteTexture(one));
    this.#arena = null;
    this.#dropWork();
    if (!this.#shown.length) return;
    let rows = 0;
    for (const one of this.#shown) [one.first, rows] = [rows, rows + one.item.rows];
    const degree = Math.max(...this.#shown.map(({ splats }) => splats.degree));
    const asked = new Set(this.#shown.map(({ splats }) => splats.antialias));
    const antialias = asked.size > 1 ? 2 : +asked.has(true);
    const size = 1 << table.row_bits;
    const [texels, components] = [table.colour_texels[degree], degree ? 4 : 3];
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (Math.max(rows, size * texels) > most) throw new Error(`these splats need textures larger than the ${most} of this device`);
    const colours = new Float32Array(rows * size * texels * components);
    for (const { splats, first } of this.#shown) fillColours(colours, splats, first * size, texels * components);
    gl.activeTexture(gl.TEXTURE0);
    this.#arena = {
      degree,
      antialias,
      rows,
      surfaced: this.#shown.some(({ splats }) => splats.surface),
      surfaces: null,
      posed: texture(gl, 'RGBA32F', 4 * size, rows),
      colours: texture(gl, degree ? 'RGBA32F' : 'RGB32F', size * texels, rows, colours),
    };
    this.#checkMemory();
  }

  /** What light falls on (light.glsl): without light nobody pays for it. */
  #surfaces() {
    const [arena, size] = [this.#arena, 1 << this.#programs.table.row_bits];
    if (!arena.surfaces) {
      const rows = new Float32Array(arena.rows * size * 8);
      for (const { splats, first } of this.#shown) fillSurfaces(rows, splats, first * size * 8);
      arena.surfaces = texture(this.#gl, 'RGBA32F', 2 * size, arena.rows, rows);
      this.#checkMemory();
    }
    return arena.surfaces;
  }

  #checkMemory() {
    if (this.#gl.getError() === this.#gl.OUT_OF_MEMORY) throw new Error('not enough memory for these splats');
  }

  /** Programs and work buffers for so many views and splats. */
  #work(views, count) {
    const [gl, { degree = 0, antialias = 0, surfaced = false }] = [this.#gl, this.#arena ?? {}];
    const [was, lit] = [this.#frame, Boolean(this.light && surfaced)];
    if (was?.views === views && was.count >= count && was.triangle === this.triangle && was.lit === lit) return was;
    this.#dropWork();
    const shared = +(degree === 0);
    const project = this.#programs.get(`project ${degree} ${antialias} ${views} ${+lit}`);
    const draw = this.#programs.get(`splat ${shared} ${+(antialias > 0)} ${views} ${+this.triangle}`);
    const own = 5 + (shared ? 0 : 3) + (antialias ? 1 : 0);
    const floats = own * views + (shared ? 3 : 0) + (antialias ? 0 : 1);
    const most = Math.max(1, this.#shown.reduce((sum, { splats }) => sum + splats.count, 0), count);
    const rows = Math.ceil((most * floats) / RECORD_ROW);
    const order = buffer(gl, 4 * most, gl.STREAM_DRAW);
    gl.activeTexture(gl.TEXTURE0);
    this.#frame = {
      views, lit, project, draw, floats, order, count: most, triangle: this.triangle,
      records: buffer(gl, 4 * rows * RECORD_ROW, gl.DYNAMIC_COPY),
      texture: texture(gl, 'R32F', RECORD_ROW, rows),
      array: vertexArray(gl, [{ location: project.attributes.order, buffer: order, size: 1, type: gl.UNSIGNED_INT }]),
    };
    return this.#frame;
  }

  #dropWork() {
    if (!this.#frame) return;
    const [gl, { order, records, texture: made, array }] = [this.#gl, this.#frame];
    for (const one of [order, records]) gl.deleteBuffer(one);
    gl.deleteTexture(made);
    gl.deleteVertexArray(array);
    this.#frame = null;
  }
}

/** Coefficients as sh.glsl reads them, rgb after rgb; higher ones are 0. */
function fillColours(out, { count, sh, degree }, first, stride) {
  const own = 3 * (degree + 1) ** 2;
  for (let i = 0; i < count; i++) out.set(sh.subarray(own * i, own * i + own), (first + i) * stride);
}

