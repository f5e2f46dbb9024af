// Avatars by the hash of their files: fetched once, kept in the browser's cache, usable from their coarsest level on.

import { SPLATS_CACHE } from '../settings.js';
import { chunksOf, readAvatar } from './avatar.js';

const MOST = 8; // avatars in memory at most, beyond those that are shown
const PAUSE = 5000; // ms before a failed file is fetched again

export class AvatarCache {
  #fetch;
  #held = new Map(); // by hash, least recently used first: {avatar, whole, why, until}

  /** `fetched(path)` resolves to a Response for a path of the server, as Connection.fetch. */
  constructor(fetched) {
    this.#fetch = fetched;
  }

  /** Return the avatar of a hash, or null while none of its levels is there; fetch it if needed. */
  get(sha256, now) {
    let one = this.#held.get(sha256);
    if (!one || (one.why && now >= one.until)) {
      one = { avatar: null, whole: false, why: '', until: 0 };
      this.#read(sha256, one);
    }
    this.#held.delete(sha256); // most recently used
    this.#held.set(sha256, one);
    return one.avatar;
  }

  /** Return why the avatar of a hash cannot be drawn, in words, or ''. */
  why(sha256) {
    return this.#held.get(sha256)?.why ?? '';
  }

  /** Return whether all of the file has arrived. */
  whole(sha256) {
    return this.#held.get(sha256)?.whole ?? false;
  }

  get size() {
    return this.#held.size;
  }

  /** Evict the least recently used avatars, but not `hashes`, which are shown. */
  keep(hashes) {
    for (const sha256 of this.#held.keys()) {
      if (this.#held.size <= MOST) return;
      if (!hashes.has(sha256)) this.#held.delete(sha256);
    }
  }

  /** Delete files from the browser's cache, but not `hashes`, which are handed out now. */
  async sweep(hashes) {
    const kept = await store();
    const wanted = new Set(hashes.map(keyOf));
    for (const { url } of (await kept?.keys().catch(() => [])) ?? []) if (!wanted.has(url)) await kept.delete(url);
  }

  /** Delete an avatar that is no longer handed out, here and from the browser's cache. */
  async forget(sha256) {
    this.#held.delete(sha256);
    await (await store())?.delete(keyOf(sha256));
  }

  async #read(sha256, one) {
    try {
      const response = await this.#response(sha256);
      if (!response.ok) throw new Error((await response.text()).trim().slice(0, 200) || `the server answers ${response.status}`);
      await readAvatar(chunksOf(response), (avatar) => {
        one.avatar = avatar;
      });
      one.whole = true;
    } catch (error) {
      await (await store())?.delete(keyOf(sha256)).catch(() => {}); // it may be damaged
      Object.assign(one, { avatar: null, why: `the avatar did not load: ${error.message}`, until: performance.now() + PAUSE });
    }
  }

  async #response(sha256) {
    const kept = await store();
    const found = await kept?.match(keyOf(sha256)).catch(() => null);
    if (found) return found;
    const response = await this.#fetch(`splats/${sha256}`);
    if (response.ok) kept?.put(keyOf(sha256), response.clone()).catch(() => {}); // without a copy if the disk is full
    return response;
  }
}

/** Return the browser's cache of files; null where it has none for this page (no https) or denies it. */
async function store() {
  return globalThis.caches?.open(SPLATS_CACHE).catch(() => null) ?? null;
}

const keyOf = (sha256) => new URL(`../../splats/${sha256}`, import.meta.url).href;
