// Draws a place: room, sky, the shadows of who stands in it, a mirror with its frame. Knows neither avatars nor sessions.

import { dot, multiply, reflection } from '../space/matrix.js';
import { ATLAS, GRAIN, bake, baking, grain, shown } from './bake.js';
import { LOOKS } from './looks.js';
import { flatMesh, floorMesh, mirrorMesh, roomMesh, starMesh } from './mesh.js';
import { GLASS, ROOM, SHADOW, SKY, build } from './shaders.js';

const MOST_BLOBS = 16;
const STRIDE = 36; // bytes a vertex
const IN_PASSTHROUGH = 0.62; // how dark shadows are on a floor that is not ours
const TINT = [0, 0.015, 0.015, 0.24]; // of a mirror's glass, which makes what it shows darker
const TINT_IN_PASSTHROUGH = [0.03, 0.036, 0.039, 0.3];
const TURN = [8, 100]; // ms in a row that baking takes of a page that shows pictures, at least and at most
const SOURCES = { sky: SKY, room: ROOM, shadow: SHADOW, glass: GLASS };

const baked = new Map(); // by name: the bytes of the faces; null while it is worked on

export class Place {
  /** Triangles of the room and texels of its textures, for whoever counts. */
  counts = { triangles: 0, texels: 0 };
  #gl;
  #programs = new Map();
  #look = null;
  #textures = null; // {faces, grain}
  #metres = [0, 0];
  #room;
  #stars;
  #passing; // of one frame
  #backdrop;

  constructor(gl) {
    this.#gl = gl;
    this.#backdrop = new Backdrop(gl);
    [this.#room, this.#stars, this.#passing] = [this.#buffer(), this.#buffer(), this.#buffer()];
  }

  /** Whether `choose` takes no time. Where it would, the place is worked out meanwhile, a little at a time. */
  prepare(name) {
    if (!LOOKS[name] || baked.get(name)) return true;
    if (!baked.has(name)) bakeBetween(name);
    return false;
  }

  /** Which of LOOKS is drawn; false where there is none of that name. It is worked out when it is first chosen. */
  choose(name) {
    const look = LOOKS[name] ?? null;
    if (look === this.#look) return look !== null;
    this.#look = look;
    if (!look) return false;
    const gl = this.#gl;
    this.#textures ??= { faces: gl.createTexture(), grain: gl.createTexture() };
    this.#texture(this.#textures.faces, gl.RGBA, ATLAS.width, ATLAS.height, baked.get(name) ?? bake(look), gl.CLAMP_TO_EDGE);
    const floor = grain(look);
    this.#metres = floor?.metres ?? [0, 0];
    const side = floor ? GRAIN : 1;
    this.#texture(this.#textures.grain, gl.LUMINANCE, side, side, floor?.bytes ?? new Uint8Array([128]), gl.REPEAT);
    if (floor) {
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      const sharp = gl.getExtension('EXT_texture_filter_anisotropic');
      if (sharp) gl.texParameteri(gl.TEXTURE_2D, sharp.TEXTURE_MAX_ANISOTROPY_EXT, 4);
    }
    this.#fill(this.#room, roomMesh(look));
    this.#fill(this.#stars, starMesh(look));
    this.counts = { triangles: this.#room.vertices / 3, texels: ATLAS.width * ATLAS.height + (floor ? GRAIN * GRAIN : 0) };
    return true;
  }

  /** The room around an eye {transform, projection, viewport}, `still` the view whose canvas it is, or null. */
  room(eye, clip, still = null) {
    if (still === null) return this.#paintRoom(eye, clip);
    const { transform, projection, viewport } = eye;
    const key = [this.#look, ...transform, ...projection, ...Object.values(viewport)];
    this.#backdrop.draw(still, viewport, key, () => this.#paintRoom(eye, clip));
  }

  /** `mirror`: {glass, normal, blobs} if this is the room in it. */
  #paintRoom({ transform, projection }, clip, mirror = null) {
    const gl = this.#gl;
    gl.disable(gl.BLEND);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    this.#solid(clip, this.#room, mirror);
    if (this.#stars.vertices) this.#draw(this.#stars, gl.POINTS);
    const at = this.#begin('sky');
    const turn = [...transform.slice(0, 12), 0, 0, 0, 1];
    gl.uniformMatrix4fv(at.room_from_clip, false, new Float32Array(multiply(turn, unprojection(projection))));
    this.#sky(at);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
  }

  /** Shadows `blobs` [x, z, radius, strength] on the floor: the room's, or one that is not ours. */
  shadows(clip, blobs, inRoom) {
    if (!blobs.length) return;
    const at = this.#begin('shadow');
    this.#blobs(at, blobs, inRoom ? this.#look.shadow : IN_PASSTHROUGH);
    this.#gl.uniformMatrix4fv(at.clip_from_room, false, clip);
    this.#fill(this.#passing, floorMesh(blobs));
    this.#draw(this.#passing);
  }

  /** A mirror with its frame; `blobs` are on the floor that it reflects. In passthrough it shows no room. */
  mirror({ transform, projection }, clip, { glass, normal }, blobs, passthrough) {
    const gl = this.#gl;
    const pane = flatMesh(glass, normal);
    if (!passthrough) {
      // its room is as far as can be, all else of the view as near: so nothing is painted beside the glass
      gl.clearDepth(0);
      gl.clear(gl.DEPTH_BUFFER_BIT);
      gl.clearDepth(1);
      gl.enable(gl.DEPTH_TEST);
      gl.depthFunc(gl.ALWAYS);
      gl.depthRange(1, 1);
      this.#flat(clip, pane, TINT);
      gl.depthRange(0, 1);
      const turn = reflection(glass[0], normal);
      this.#paintRoom({ transform: multiply(turn, transform), projection }, new Float32Array(multiply([...clip], turn)), { glass, normal, blobs });
    }
    this.#flat(clip, pane, passthrough ? TINT_IN_PASSTHROUGH : TINT);
    const lit = this.#look.ambient.map((value, k) => Math.min(1, value / LOOKS.day.ambient[k]));
    this.#fill(this.#passing, mirrorMesh(glass, normal, lit));
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.DEPTH_BUFFER_BIT); // before all that the room has
    this.#solid(clip, this.#passing);
    gl.disable(gl.DEPTH_TEST);
  }

  #begin(name) {
    if (!this.#programs.has(name)) this.#programs.set(name, build(this.#gl, SOURCES[name]));
    const { use, at } = this.#programs.get(name);
    use();
    return at;
  }

  #sky(at) {
    this.#gl.uniform3fv(at.zenith, shown(this.#look.sky.zenith));
    this.#gl.uniform3fv(at.horizon, shown(this.#look.sky.horizon));
  }

  #blobs(at, blobs, dark) {
    const few = blobs.slice(0, MOST_BLOBS);
    this.#gl.uniform1i(at.blob_count, few.length);
    this.#gl.uniform1f(at.shadow, dark);
    if (few.length) this.#gl.uniform4fv(at['blobs[0]'], few.flat());
  }

  #faces(at) {
    const gl = this.#gl;
    gl.uniform2fv(at.metres, this.#metres);
    gl.uniform1i(at.faces, 0);
    gl.uniform1i(at.grain, 1);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.#textures.grain);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.#textures.faces);
  }

  /** Triangles that hide each other, those that face away left out; of the room in a `mirror` those behind it as well. */
  #solid(clip, mesh, mirror = null) {
    const gl = this.#gl;
    const at = this.#begin('room');
    this.#faces(at);
    this.#blobs(at, mirror?.blobs ?? [], this.#look.shadow);
    gl.uniform4fv(at.before, mirror ? [...mirror.normal, -dot(mirror.normal, mirror.glass[0])] : [0, 0, 0, 0]);
    gl.uniformMatrix4fv(at.clip_from_room, false, clip);
    gl.enable(gl.CULL_FACE);
    gl.frontFace(mirror ? gl.CW : gl.CCW);
    this.#draw(mesh);
    gl.frontFace(gl.CCW);
    gl.disable(gl.CULL_FACE);
  }

  /** Triangles `floats` in one premultiplied colour. */
  #flat(clip, floats, paint) {
    const at = this.#begin('glass');
    this.#gl.uniformMatrix4fv(at.clip_from_room, false, clip);
    this.#gl.uniform4fv(at.paint, paint);
    this.#fill(this.#passing, floats);
    this.#draw(this.#passing);
  }

  #draw({ array, vertices }, mode = this.#gl.TRIANGLES) {
    this.#gl.bindVertexArray(array);
    this.#gl.drawArrays(mode, 0, vertices);
    this.#gl.bindVertexArray(null);
  }

  #texture(texture, format, width, height, bytes, wrap) {
    const gl = this.#gl;
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, format, width, height, 0, format, gl.UNSIGNED_BYTE, bytes);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, wrap);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.LINEAR);
  }

  #buffer() {
    const gl = this.#gl;
    const [array, buffer] = [gl.createVertexArray(), gl.createBuffer()];
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    for (let i = 0; i < 3; i++) {
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, 3, gl.FLOAT, false, STRIDE, 12 * i);
    }
    gl.bindVertexArray(null);
    return { array, buffer, vertices: 0 };
  }

  #fill(mesh, floats) {
    const gl = this.#gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, mesh.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, floats, gl.DYNAMIC_DRAW);
    mesh.vertices = (4 * floats.length) / STRIDE;
  }
}

async function bakeBetween(name) {
  baked.set(name, null);
  const rows = baking(LOOKS[name]);
  let before = performance.now();
  for (;;) {
    // where frames are slow there are few turns: a third of what was between them, or the room would never come
    const until = performance.now() + Math.min(TURN[1], Math.max(TURN[0], (performance.now() - before) / 3));
    while (performance.now() < until) {
      const { done, value } = rows.next();
      if (done) return baked.set(name, value);
    }
    before = performance.now();
    await new Promise((done) => setTimeout(done));
  }
}

/** The inverse of an OpenGL projection, off-centre ones included. */
function unprojection(p) {
  const out = new Array(16).fill(0);
  [out[0], out[5]] = [1 / p[0], 1 / p[5]];
  [out[12], out[13], out[14]] = [p[8] / p[0], p[9] / p[5], -1];
  [out[11], out[15]] = [1 / p[14], p[10] / p[14]];
  return out;
}

/**
 * What lies behind the pictures is painted once for an eye that rests, and copied from then on: where pixels are painted
 * by a processor, a room costs more than the picture before it.
 */
class Backdrop {
  #gl;
  #kept = []; // by view: {key, texture, framebuffer, whole}

  constructor(gl) {
    this.#gl = gl;
  }

  /**
   * The canvas of view `index`, whose viewport is {x, y, width, height}, as `paint()` leaves it; `key`, an array, says
   * all that it depends on. An eye that moves is painted as ever: a copy is made the second time that nothing changed.
   */
  draw(index, viewport, key, paint) {
    const kept = (this.#kept[index] ??= { key: [], whole: false });
    const same = key.length === kept.key.length && key.every((value, i) => value === kept.key[i]);
    if (same && kept.whole) return this.#put(kept, viewport);
    paint();
    if (same) this.#keep(kept, viewport);
    else Object.assign(kept, { key, whole: false });
  }

  #keep(kept, { x, y, width, height }) {
    const gl = this.#gl;
    kept.texture ??= gl.createTexture();
    kept.framebuffer ??= gl.createFramebuffer();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, kept.texture);
    gl.copyTexImage2D(gl.TEXTURE_2D, 0, gl.RGB, x, y, width, height, 0);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, kept.framebuffer);
    gl.framebufferTexture2D(gl.READ_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, kept.texture, 0);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    kept.whole = true;
  }

  /** Copies only where the canvas has no samples: `antialias: false` when its context is made. */
  #put({ framebuffer }, { x, y, width, height }) {
    const gl = this.#gl;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, framebuffer);
    gl.blitFramebuffer(0, 0, width, height, x, y, x + width, y + height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
  }
}
