// Everything the page draws with WebGL2: a place, the newest pairs, a mirror's frame, labels. Knows no sessions.

import { shown } from '../place/bake.js';
import { Place } from '../place/place.js';
import { IDENTITY, add, apply, axis, cross, dot, invert, movePoint, multiply, place, scale, subtract, unit } from '../space/matrix.js';
import { buildPrograms } from './shaders.js';

const FRAME = 0.03; // metres around a mirror's glass
const COLOURS = { frame: [0.45, 0.36, 0.22, 1], glass: [0, 0, 0, 1], floor: [0.22, 0.26, 0.33, 1] };
const SOLID = 0.5; // alpha of what hides what is behind it, where a picture has depth
const FLOOR = { half: 5, step: 1, fade: 6 }; // metres

export class Painter {
  textures = 0; // alive, for leak tests
  place; // what stands around; one that is not chosen is a grid in the dark
  #gl;
  #programs;
  #pairs = [0, 1].map(() => ({ asked: null, eyes: [] })); // in a mirror, and before it; `asked`: what Framing.frame returned for
  // it, with `info` of the reply; by eye: {colour, alpha, box, hasAlpha, grid}
  #mesh;
  #floor;
  #floorVertices;

  constructor(gl) {
    this.#gl = gl;
    this.#programs = buildPrograms(gl);
    this.place = new Place(gl);
    this.#mesh = this.#buffers(2);
    const lines = floorLines();
    this.#floor = this.#buffers(1);
    this.#floorVertices = lines.length / 3;
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(lines), gl.STATIC_DRAW);
  }

  /** What the pairs were asked for with, {cameras, plane, where}, and `info` of their replies: of a mirror, and of what is not in one. */
  get shownAs() {
    return this.#pairs.map(({ asked }) => asked).filter(Boolean);
  }

  forget() {
    for (const pair of this.#pairs) pair.asked = null;
  }

  /**
   * Take over a pair: {pictures: [[colour, alpha | null], ...], info, asked, depth: grids | null}; its bitmaps may be
   * closed afterwards. What has no depth is put on the plane that it was asked for with.
   */
  upload({ pictures, info, asked, depth }) {
    const [width, height] = info.size;
    const pair = this.#pairs[asked.where.mirror ? 0 : 1];
    pictures.forEach(([colour, alpha], i) => {
      const eye = (pair.eyes[i] ??= { colour: this.texture(), alpha: this.texture(), grid: new Grid(this.#gl) });
      this.fill(eye.colour, colour);
      if (alpha) this.fill(eye.alpha, alpha);
      eye.hasAlpha = alpha !== null;
      const [x, y, w, h] = info.crop?.[i] ?? [0, 0, width, height];
      eye.grid.fill(depth?.[i] ?? planeGrid(asked.cameras[i], asked.plane));
      eye.box = [x / width, y / height, w / width, h / height];
    });
    pair.asked = { ...asked, info };
  }

  texture() {
    const gl = this.#gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.LINEAR);
    this.textures++;
    return texture;
  }

  /** An image (bitmap, canvas) into a texture as it is: no flip, no conversion. */
  fill(texture, image, premultiply = false) {
    const gl = this.#gl;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, premultiply);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
  }

  /** Bind a framebuffer (null: the canvas) and clear it to a look's horizon; see-through where the room is to show. */
  begin(framebuffer, transparent, look = null) {
    const gl = this.#gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.clearColor(...(look && !transparent ? shown(look.sky.horizon) : [0, 0, 0]), transparent ? 0 : 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
  }

  /**
   * One view {transform, projection, viewport}: index 0 or 1 of the pair. `room`: draw the place as well, else (in
   * passthrough) its mirror and shadows alone. `seat`: the place from the space of all else here. `mirror`: {glass,
   * normal}; `blobs`: shadows of place/shadow.js in the place, which the mirror shows where there is one; `picture`
   * false leaves the pair out; `keeps`: what is drawn into is the canvas, for an eye that mostly rests.
   */
  view(eye, index, { room, seat = IDENTITY, mirror = null, labels = [], look = 'plain', blobs = [], picture = true, keeps = false }) {
    const gl = this.#gl;
    const { transform, projection, viewport: { x, y, width, height } } = eye;
    gl.viewport(x, y, width, height);
    const clip = new Float32Array(multiply(projection, invert(transform)));
    const placed = this.place.choose(look);
    if (placed) {
      const seen = mirror && !mirror.whole ? [] : blobs; // alone there is nobody but in the mirror
      const there = { ...eye, transform: multiply(seat, transform) };
      const from = new Float32Array(multiply(projection, invert(there.transform)));
      if (room) this.place.room(there, from, keeps ? index : null);
      this.place.shadows(from, seen, room);
      if (mirror) this.place.mirror(there, from, moved(mirror, seat), blobs, !room);
    } else {
      if (room) this.#drawFloor(clip, transform);
      if (mirror) this.#drawMirror(clip, mirror.glass);
    }
    for (const pair of this.#pairs) if (pair.asked && picture) this.#drawPicture(pair, clip, transform, index);
    for (const label of labels) this.#drawLabel(clip, label);
  }

  /** Labels alone, over what else was drawn into a view by now. */
  labels({ transform, projection, viewport: { x, y, width, height } }, labels) {
    this.#gl.viewport(x, y, width, height);
    const clip = new Float32Array(multiply(projection, invert(transform)));
    for (const label of labels) this.#drawLabel(clip, label);
  }

  #drawPicture({ asked: { cameras, where }, eyes }, clip, transform, index) {
    const gl = this.#gl;
    const shown = Math.min(index, cameras.length - 1);
    const [eye, camera] = [eyes[shown], cameras[shown]];
    const { use, at } = this.#programs.picture;
    use();
    gl.uniformMatrix4fv(at.clip_from_camera, false, new Float32Array(multiply(clip, camera.transform)));
    gl.uniformMatrix4fv(at.cuts, false, new Float32Array(cuts(where.glass, camera, transform)));
    gl.uniform4fv(at.extent, extent(camera));
    gl.uniform2i(at.grid, ...eye.grid.size);
    gl.uniform4fv(at.box, eye.box);
    gl.uniform1i(at.has_alpha, eye.hasAlpha ? 1 : 0);
    gl.uniform1i(at.colour, 0);
    gl.uniform1i(at.alpha, 1);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, eye.alpha);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, eye.colour);
    const draw = (from, upTo) => {
      gl.uniform2f(at.range, from, upTo);
      eye.grid.draw();
    };
    if (eye.grid.flat) {
      draw(0, 2);
      return;
    }
    // what is near hides what is far, but for its soft rim, which is blended over that
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.DEPTH_BUFFER_BIT); // of the place
    draw(SOLID, 2);
    gl.depthMask(false);
    draw(0, SOLID);
    gl.depthMask(true);
    gl.disable(gl.DEPTH_TEST);
  }

  #drawMirror(clip, glass) {
    const [low, right, , left] = glass;
    const u = along(low, right, FRAME);
    const v = along(low, left, FRAME);
    const grown = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b], i) => add(glass[i], add(scale(u, a), scale(v, b))));
    // around the glass, not behind it: what is covered is not drawn twice
    this.#drawFlat(clip, [0, 1, 2, 3, 0].flatMap((i) => [grown[i], glass[i]]), COLOURS.frame);
    this.#drawFlat(clip, [3, 2, 0, 1].map((i) => glass[i]), COLOURS.glass);
  }

  /** A triangle strip in one colour. */
  #drawFlat(clip, strip, paint) {
    const gl = this.#gl;
    const { use, at } = this.#programs.flat;
    use();
    gl.uniformMatrix4fv(at.clip_from_room, false, clip);
    gl.uniform4fv(at.paint, paint);
    gl.uniform1f(at.fade, 0);
    this.#drawStrip(strip, strip);
  }

  #drawFloor(clip, transform) {
    const gl = this.#gl;
    const { use, at } = this.#programs.flat;
    use();
    gl.uniformMatrix4fv(at.clip_from_room, false, clip);
    gl.uniform4fv(at.paint, COLOURS.floor);
    gl.uniform1f(at.fade, FLOOR.fade);
    gl.uniform3fv(at.eye, place(transform));
    gl.bindVertexArray(this.#floor.array);
    gl.drawArrays(gl.LINES, 0, this.#floorVertices);
    gl.bindVertexArray(null);
  }

  /** {texture, transform (room from label, x right, y up), width, height in metres}, or {strip, paint} in one colour. */
  #drawLabel(clip, { texture, transform, width, height, strip, paint }) {
    if (strip) return this.#drawFlat(clip, strip, paint);
    const gl = this.#gl;
    const u = scale(axis(transform, 0), width / 2);
    const v = scale(axis(transform, 1), height / 2);
    const at3 = (a, b) => add(place(transform), add(scale(u, a), scale(v, b)));
    const { use, at } = this.#programs.label;
    use();
    gl.uniformMatrix4fv(at.clip_from_room, false, clip);
    gl.uniform1i(at.colour, 0);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    this.#drawStrip([at3(-1, 1), at3(1, 1), at3(-1, -1), at3(1, -1)], [[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]]);
  }

  #drawStrip(positions, texels) {
    const gl = this.#gl;
    const data = new Float32Array(positions.flatMap((p, i) => [...p.slice(0, 3), ...texels[i].slice(0, 3)]));
    gl.bindVertexArray(this.#mesh.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#mesh.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STREAM_DRAW);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, positions.length);
    gl.bindVertexArray(null);
  }

  /** A vertex array of `count` vec3 side by side in one buffer, which stays bound. */
  #buffers(count) {
    const gl = this.#gl;
    const array = gl.createVertexArray();
    const buffer = gl.createBuffer();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    for (let i = 0; i < count; i++) {
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, 3, gl.FLOAT, false, 12 * count, 12 * i);
    }
    gl.bindVertexArray(null);
    return { array, buffer };
  }
}

/** A mirror {glass, normal} moved by a matrix without scale. */
function moved({ glass, normal }, by) {
  return { glass: glass.map((point) => movePoint(by, point)), normal: apply(by, [...normal, 0]).slice(0, 3) };
}

/** A vector of that length from a towards b. */
function along(a, b, size) {
  const d = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
  return scale(d, size / Math.hypot(...d));
}

/** A grid in short pieces: some drivers lose a line that begins behind the eye. */
function floorLines() {
  const out = [];
  for (let i = -FLOOR.half; i <= FLOOR.half; i += FLOOR.step) {
    for (let k = -FLOOR.half; k < FLOOR.half; k += FLOOR.step) {
      out.push(i, 0, k, i, 0, k + FLOOR.step, k, 0, i, k + FLOOR.step, 0, i);
    }
  }
  return out;
}

/** Points over a picture with the inverse depth of each, two triangles between any four of them, on the GPU. */
class Grid {
  size = [0, 0]; // columns, rows
  #gl;
  #array;
  #points;
  #corners;

  constructor(gl) {
    this.#gl = gl;
    this.#array = gl.createVertexArray();
    [this.#points, this.#corners] = [gl.createBuffer(), gl.createBuffer()];
    gl.bindVertexArray(this.#array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#points);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 1, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.#corners);
    gl.bindVertexArray(null);
  }

  /** Whether nothing of it can hide another part. */
  get flat() {
    return this.size[0] * this.size[1] <= 4;
  }

  /** Take over {columns, rows, inverse: Float32Array, row by row}. */
  fill({ columns, rows, inverse }) {
    const gl = this.#gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#points);
    gl.bufferData(gl.ARRAY_BUFFER, inverse, gl.STREAM_DRAW);
    if (columns === this.size[0] && rows === this.size[1]) return;
    this.size = [columns, rows];
    const corners = [];
    for (let i = 0; i < columns * (rows - 1); i++) {
      if ((i + 1) % columns) corners.push(i, i + 1, i + columns, i + 1, i + columns + 1, i + columns);
    }
    gl.bindVertexArray(this.#array);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint16Array.from(corners), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
  }

  draw() {
    const gl = this.#gl;
    gl.bindVertexArray(this.#array);
    gl.drawElements(gl.TRIANGLES, 6 * (this.size[0] - 1) * (this.size[1] - 1), gl.UNSIGNED_SHORT, 0);
    gl.bindVertexArray(null);
  }
}

const GRAZING = 0.1; // cosine; a plane seen at a flatter angle is put straight before the eye instead
const NEAREST = 0.3; // metres to one that is

/**
 * A plane as a grid of 2 x 2 points over the picture of `camera` ({transform, frustum}): {columns, rows, inverse}, as
 * replies have them. Inverse depth of a plane is linear in the picture, so its corners are exact.
 */
function planeGrid({ transform, frustum: f }, { point, normal }) {
  const ends = [[f.left, f.up], [f.right, f.up], [f.left, f.down], [f.right, f.down]];
  const rays = ends.map(([x, y]) => apply(transform, [x, y, -1, 0]).slice(0, 3)); // as long as -z is 1
  const reach = dot(subtract(point, place(transform)), normal);
  const steep = rays.every((ray) => dot(unit(ray), normal) < -GRAZING);
  const straight = 1 / Math.max(NEAREST, Math.abs(reach));
  return { columns: 2, rows: 2, inverse: Float32Array.from(rays, (ray) => (steep ? dot(ray, normal) / reach : straight)) };
}

/** Of a camera's picture, in tangents: [left, up, width, height]. */
export const extent = ({ frustum: f }) => [f.left, f.up, f.right - f.left, f.up - f.down];

/**
 * The planes through an eye at `transform` and the edges of a `glass` (4 corners around it), four columns of a matrix
 * in the axes of `camera`: what is seen through the glass has no product below 0 with any of them. Nothing where there
 * is no glass.
 */
export function cuts(glass, camera, transform) {
  if (!glass) return new Array(16).fill(0);
  const eye = place(transform);
  const middle = scale(glass.reduce(add, [0, 0, 0]), 1 / glass.length);
  const back = invert(camera.transform);
  return glass.flatMap((corner, i) => {
    const edge = cross(subtract(corner, eye), subtract(glass[(i + 1) % glass.length], eye));
    const normal = scale(edge, dot(subtract(middle, eye), edge) < 0 ? -1 : 1);
    return [...apply(back, [...normal, 0]).slice(0, 3), dot(normal, subtract(place(camera.transform), eye))];
  });
}
