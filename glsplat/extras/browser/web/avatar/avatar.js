// An avatar in this browser: its levels of detail as they arrive, the level for a view, and the avatar without its
// head.

import { BlobError, headOf, openBlob, shapesOf, splatsOf, surfaceOf } from './blob.js';
import { chosen, densityOf, proxyOf } from './detail.js';

/** The avatar of one file. `levels`: splats by level, 0 the finest, as they arrive. */
class Avatar {
  levels = new Map();
  #densities = []; // of the coarser levels, from 1
  #proxy = null;
  #parts = new Map(); // results of `without`, by splats

  constructor({ header, skeleton }) {
    this.skeleton = skeleton;
    this.names = header.shapes?.names ?? [];
    const levels = header.parts.filter(({ kind }) => kind === 'splats');
    for (const { level, density } of levels) if (level > 0) this.#densities[level - 1] = density;
  }

  /** Add the splats of a level, or replace them by those with shapes or a surface. */
  add(level, splats) {
    this.levels.set(level, splats);
    if (!this.#proxy || level === 0) this.#proxy = proxyOf(splats);
  }

  /** Return the level for cameras (frame.js) and a pose, of those that are there. `before`: the cameras' last level. */
  levelFor(cameras, bones, place, before) {
    const density = Math.max(...cameras.map((camera) => densityOf(this.#proxy, camera, bones, place)));
    let level = density > 0 ? chosen(this.#densities, density, before) : (before ?? this.#densities.length);
    if (!this.levels.has(level)) level = [...this.levels.keys()].sort((a, b) => Math.abs(a - level) - Math.abs(b - level))[0];
    return level;
  }

  /** Return splats without those that mostly follow joint `name` and its children. Twin: Avatar.without. */
  without(splats, name) {
    const joint = this.skeleton.names.indexOf(name);
    if (joint < 0) return splats;
    if (!this.#parts.has(splats)) this.#parts.set(splats, partOf(splats, under(this.skeleton.parents, joint)));
    return this.#parts.get(splats);
  }
}

/**
 * Read an avatar from chunks of bytes (an async iterable of Uint8Array). `onLevel(avatar, level)` is called for each
 * level as soon as it can be drawn. Returns the avatar. Throws BlobError.
 */
export async function readAvatar(chunks, onLevel = () => {}) {
  const received = new Received(chunks);
  await received.have(16);
  await received.have(headOf(received.bytes).end);
  const { header, skeleton, start } = await openBlob(received.bytes);
  const avatar = new Avatar({ header, skeleton });
  for (const part of header.parts) {
    const [from, to] = [start + part.offset, start + part.offset + part.bytes];
    await received.have(to);
    const bytes = received.bytes.slice(from, to);
    if (part.kind === 'splats') {
      avatar.add(part.level, await splatsOf(header, part, bytes));
    } else {
      const splats = avatar.levels.get(part.level);
      const [kind, more] = [part.kind, part.kind === 'shapes' ? shapesOf(header, part, splats.count, bytes) : surfaceOf(part, splats.count, bytes)];
      avatar.add(part.level, { ...splats, [kind]: await more });
    }
    onLevel(avatar, part.level);
  }
  return avatar;
}

/** Yield the chunks of a Response for `readAvatar`; cancel the fetch if reading ends early. */
export async function* chunksOf(response) {
  const reader = response.body.getReader();
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      yield value;
    }
  } finally {
    reader.cancel().catch(() => {});
  }
}

/** The bytes received so far. */
class Received {
  #store = new Uint8Array(1 << 17);
  #size = 0;
  #chunks;

  constructor(chunks) {
    this.#chunks = chunks[Symbol.asyncIterator]();
  }

  get bytes() {
    return this.#store.subarray(0, this.#size);
  }

  async have(size) {
    while (this.#size < size) {
      const { done, value } = await this.#chunks.next();
      if (done) throw new BlobError('this avatar is truncated');
      if (this.#size + value.length > this.#store.length) {
        const grown = new Uint8Array(Math.max(2 * this.#store.length, this.#size + value.length));
        grown.set(this.bytes);
        this.#store = grown;
      }
      this.#store.set(value, this.#size);
      this.#size += value.length;
    }
  }
}

/** Return for each joint whether it is `joint` or below it. */
function under(parents, joint) {
  return parents.map((_, j) => {
    let k = j;
    while (k >= 0 && k !== joint) k = parents[k];
    return k === joint;
  });
}

function partOf(splats, left) {
  const { count, joints, weights, influences: n, shapes, surface } = splats;
  const kept = [];
  for (let i = 0; i < count; i++) {
    let share = 0;
    for (let k = n * i; k < n * (i + 1); k++) share += left[joints[k]] ? weights[k] : 0;
    if (share <= 0.5) kept.push(i);
  }
  const take = (array, size) => {
    const out = new array.constructor(size * kept.length);
    kept.forEach((i, at) => out.set(array.subarray(size * i, size * (i + 1)), size * at));
    return out;
  };
  const sizes = { means: 3, quats: 4, scales: 3, opacities: 1, sh: splats.sh.length / count, joints: n, weights: n };
  const arrays = Object.entries(sizes).map(([name, size]) => [name, take(splats[name], size)]);
  const known = surface && { normals: take(surface.normals, 3), occlusion: take(surface.occlusion, 1), shade: surface.shade && take(surface.shade, 3) };
  return { ...splats, ...Object.fromEntries(arrays), count: kept.length, shapes: shapes && entriesOf(shapes, kept), surface: known };
}

function entriesOf(shapes, kept) {
  const starts = new Uint32Array(kept.length + 1);
  const runs = kept.map((i) => shapes.texels.subarray(4 * shapes.starts[i], 4 * shapes.starts[i + 1]));
  runs.forEach((run, at) => (starts[at + 1] = starts[at] + run.length / 4));
  const texels = new Uint32Array(4 * starts[kept.length]);
  runs.forEach((run, at) => texels.set(run, 4 * starts[at]));
  return { ...shapes, starts, texels };
}
