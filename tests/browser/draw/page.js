// What the tests of draw/ run in a page: things by address, pictures as floats in base64.

import { Skeleton, quaternionOf } from '/vr/draw/bones.js';
import { Drawing } from '/vr/draw/drawing.js';
import { cameraOfFile } from '/vr/draw/frame.js';

const TYPES = { float32: Float32Array, uint16: Uint16Array, uint32: Uint32Array, int8: Int8Array, uint8: Uint8Array };

export async function load(name) {
  const header = await (await fetch(`/vr/data/${name}.json`)).json();
  const body = await (await fetch(`/vr/data/${name}.bin`)).arrayBuffer();
  const arrays = Object.entries(header.arrays).map(([key, [type, at, size]]) => [key, new TYPES[type](body, at, size)]);
  const { skeleton, shapes, ...splats } = { ...header, ...Object.fromEntries(arrays) };
  if (shapes) splats.shapes = { ...shapes, starts: splats.starts, texels: splats.texels };
  splats.surface = splats.normals ? { normals: splats.normals, occlusion: splats.occlusion, shade: splats.shade } : null;
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

/** Layers of the kinds, as floats, rows as they lie; `upward` draws with rows from below and turns them here; `order`: by other keys than the page's. */
export async function pictures({ things, poses, cameras, kinds, triangle = false, upward = false, order = null, light = null }) {
  const table = await (await fetch('/vr/draw/programs.json')).json();
  const gl = context();
  const drawing = new Drawing(gl, table, { triangle });
  const loaded = await Promise.all(things.map(load));
  drawing.light = light;
  drawing.show(loaded);
  poses.forEach(({ pose, place, amounts }, i) =>
    drawing.pose(i, { bones: pose && loaded[i].skeleton.bones(poseOf(pose)), ...(place ? { place } : {}), amounts: amounts ? new Float32Array(amounts) : null }));
  const taken = cameras.map(cameraOfFile);
  const out = {};
  for (const kind of kinds) {
    drawing.prepare(taken, upward, order && Uint32Array.from(order));
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

async function* inPieces(bytes, size) {
  for (let at = 0; at < bytes.length; at += size) yield bytes.subarray(at, at + size);
}

/** An avatar's file as avatar.js reads it: its arrays by level in base64, and which levels came in which order. */
export async function decoded(name, piece) {
  const { readAvatar } = await import('/vr/avatar/avatar.js');
  const bytes = new Uint8Array(await (await fetch(`/vr/data/${name}`)).arrayBuffer());
  const order = [];
  const avatar = await readAvatar(inPieces(bytes, piece), (_, level) => order.push(level));
  const levels = {};
  for (const [level, splats] of avatar.levels) {
    levels[level] = {};
    for (const [key, value] of Object.entries(splats)) {
      if (ArrayBuffer.isView(value)) levels[level][key] = base64(new Uint8Array(value.buffer, value.byteOffset, value.byteLength));
    }
    if (splats.shapes) levels[level].texels = base64(new Uint8Array(splats.shapes.texels.buffer));
    for (const [key, value] of Object.entries(splats.surface ?? {})) if (value) levels[level][key] = base64(new Uint8Array(value.buffer, value.byteOffset, value.byteLength));
  }
  return { order, levels, names: avatar.names, joints: avatar.skeleton.names };
}

/** A picture by crowd.js of an avatar's file, as floats: the level is chosen by the camera. */
export async function crowdPicture({ name, pose, camera, expression = null, headless = false, light = null }) {
  const { readAvatar } = await import('/vr/avatar/avatar.js');
  const { Crowd } = await import('/vr/draw/crowd.js');
  const table = await (await fetch('/vr/draw/programs.json')).json();
  const bytes = new Uint8Array(await (await fetch(`/vr/data/${name}`)).arrayBuffer());
  const avatar = await readAvatar(inPieces(bytes, 1 << 16));
  const { width, height } = camera;
  const gl = context(width, height);
  const crowd = new Crowd(gl, table, { kind: '32f' });
  crowd.people = [{ key: 1, avatar, pose: poseOf(pose), expression }];
  const eye = { ...camera, viewport: { x: 0, y: 0, width, height } };
  const shown = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  crowd.draw([eye], null, shown, { headless: headless ? 1 : null, light });
  const floats = new Float32Array(width * height * 4);
  gl.bindFramebuffer(gl.FRAMEBUFFER, crowd.drawing.layers.framebuffers[0]);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, floats);
  const canvas = new Uint8Array(width * height * 4);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, canvas);
  const result = { floats: base64(new Uint8Array(floats.buffer)), canvas: base64(canvas), drawn: crowd.drawn, error: gl.getError() };
  crowd.release();
  gl.getExtension('WEBGL_lose_context').loseContext();
  return result;
}

const deflated = async (bytes) =>
  new Uint8Array(await new Response(new Blob([bytes]).stream().pipeThrough(new CompressionStream('deflate-raw'))).arrayBuffer());

/** Read `rounds` damaged copies of an avatar's file: {read, refused: {words: how often}, other: [what else was thrown]}. */
export async function fuzzed(name, rounds, seed) {
  const { readAvatar } = await import('/vr/avatar/avatar.js');
  const { BlobError, openBlob } = await import('/vr/avatar/blob.js');
  const whole = new Uint8Array(await (await fetch(`/vr/data/${name}`)).arrayBuffer());
  const { header, start } = await openBlob(whole);
  let state = seed;
  const random = (below) => (state = (Math.imul(state, 1664525) + 1013904223) >>> 0) % below;
  const pick = (list) => list[random(list.length)];
  const LIES = [null, -1, 0, 1, 3, 1e9, 2 ** 31, NaN, 0.5, 'x', [], {}, true, [1, 2], '__proto__', 1e308];
  const places = [];
  const walk = (value, path) => {
    if (value === null || typeof value !== 'object') return places.push(path);
    places.push(path);
    for (const key of Object.keys(value).slice(0, 4)) walk(value[key], [...path, key]);
  };
  walk(header, []);
  const out = { read: 0, refused: {}, other: [] };
  for (let i = 0; i < rounds; i++) {
    let bytes = whole.slice();
    if (i % 3 === 0) {
      for (let k = random(6); k >= 0; k--) bytes[random(i % 2 ? 2000 : bytes.length)] ^= 1 << random(8);
    } else if (i % 3 === 1) {
      bytes = bytes.subarray(0, random(bytes.length));
    } else {
      const lying = structuredClone(header);
      const path = pick(places);
      let at = lying;
      for (const key of path.slice(0, -1)) at = at[key];
      if (path.length) at[path.at(-1)] = pick(LIES);
      const text = new TextEncoder().encode(JSON.stringify(path.length ? lying : pick(LIES)) ?? '');
      const packed = await deflated(text);
      bytes = new Uint8Array(16 + packed.length + whole.length - start);
      bytes.set(whole.subarray(0, 16));
      new DataView(bytes.buffer).setUint32(8, packed.length, true);
      new DataView(bytes.buffer).setUint32(12, text.length, true);
      bytes.set(packed, 16);
      bytes.set(whole.subarray(start), 16 + packed.length);
    }
    try {
      await readAvatar(inPieces(bytes, 4096));
      out.read++;
    } catch (error) {
      if (error instanceof BlobError) out.refused[error.message] = (out.refused[error.message] ?? 0) + 1;
      else out.other.push(`${error.stack}`.slice(0, 300));
    }
  }
  return out;
}

/** Live objects of a context by kind; `wrap` before anything is made. */
function counted(gl) {
  const alive = {};
  for (const kind of ['Texture', 'Buffer', 'VertexArray', 'Framebuffer', 'Program']) {
    const seen = new Set();
    alive[kind] = seen;
    const [create, remove] = [gl[`create${kind}`].bind(gl), gl[`delete${kind}`].bind(gl)];
    gl[`create${kind}`] = () => {
      const made = create();
      seen.add(made);
      return made;
    };
    gl[`delete${kind}`] = (one) => {
      seen.delete(one);
      remove(one);
    };
  }
  return () => Object.fromEntries(Object.entries(alive).map(([kind, seen]) => [kind, seen.size]));
}

/**
 * `turns` avatars in turn, of the files named, each for `frames` frames, every second one lit, beside one that stays. Sums what is alive, and
 * the heap in MB after collecting garbage, at a third of the way and at the end.
 */
export async function inTurn({ names, turns, frames, light }) {
  const { Crowd } = await import('/vr/draw/crowd.js');
  const { AvatarCache } = await import('/vr/avatar/cache.js');
  const table = await (await fetch('/vr/draw/programs.json')).json();
  const gl = context(64, 64);
  const alive = counted(gl);
  const cache = new AvatarCache((path) => fetch(`/vr/data/${names[Number(path.slice(7)) % names.length]}`));
  const crowd = new Crowd(gl, table, { kind: '16f' });
  const shown = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  const eyes = [0, 1].map((i) => ({
    transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.06 * i, 0.2, 3.5, 1],
    projection: [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, -1, -1, 0, 0, -0.1, 0],
    viewport: { x: 32 * i, y: 0, width: 32, height: 64 },
  }));
  const waited = async (sha) => {
    while (!cache.get(sha, performance.now())) await new Promise((done) => setTimeout(done, 1));
    return cache.get(sha, performance.now());
  };
  const pose = (avatar, t) => {
    const joints = new Float64Array(4 * avatar.skeleton.count);
    for (let j = 0; j < avatar.skeleton.count; j++) quaternionOf([0.1 * Math.sin(t + j), 0, 0], 0, joints, 4 * j);
    return { joints, root: [0, 0, 0] };
  };
  const out = [];
  const stays = await waited('0');
  for (let turn = 0; turn < turns; turn++) {
    const avatar = await waited(`${turn + 1}`);
    cache.keep(new Set(['0', `${turn + 1}`]));
    for (let frame = 0; frame < frames; frame++) {
      const people = [stays, avatar].map((one, key) => ({ key, avatar: one, pose: pose(one, turn + 0.01 * frame) }));
      crowd.people = people;
      crowd.draw(eyes, null, shown, { light: frame % 2 ? light : null });
    }
    if (turn === Math.floor(turns / 3) || turn === turns - 1) {
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
      for (let i = 0; i < 3; i++) {
        gc();
        await new Promise((done) => setTimeout(done, 20));
      }
      out.push({ alive: alive(), heap: performance.memory.usedJSHeapSize / 1e6, cache: cache.size, error: gl.getError() });
    }
  }
  crowd.release();
  out.push({ alive: alive() });
  return out;
}
