// Avatars by the hash of their files: fetched once, kept by the browser, drawn from as soon as the coarsest level is there.

import { SPLATS_CACHE } from '../storage.js';
import { chunksOf, readAvatar } from './avatar.js';

const MOST = 8; // avatars in memory that nobody stands in
const PAUSE = 5000; // ms before a file that did not come is asked for again

export class AvatarCache {
  #fetch;
  #held = new Map(); // by hash, the least used first: {avatar, whole, why, until}

  /** `fetched(path)`: a Response for a path of the server, as Connection.fetch. */
  constructor(fetched) {
    this.#fetch = fetched;
  }

  /** The avatar of a hash, or null while nothing of it can be drawn; it is fetched. */
  get(sha256, now) {
    let one = this.#held.get(sha256);
    if (!one || (one.why && now >= one.until)) {
      one = { avatar: null, whole: false, why: '', until: 0 };
      this.#read(sha256, one);
    }
    this.#held.delete(sha256); // used last
    this.#held.set(sha256, one);
    return one.avatar;
  }

  /** Why the avatar of a hash cannot be drawn, in words; '' while that is not known. */
  why(sha256) {
    return this.#held.get(sha256)?.why ?? '';
  }

  /** Whether all of it has come. */
  whole(sha256) {
    return this.#held.get(sha256)?.whole ?? false;
  }

  get size() {
    return this.#held.size;
  }

  /** Nobody but these hashes is shown now: forget what has long not been used. */
  keep(hashes) {
    for (const sha256 of this.#held.keys()) {
      if (this.#held.size <= MOST) return;
      if (!hashes.has(sha256)) this.#held.delete(sha256);
    }
  }

  /** Only these hashes are handed out now: what else the browser's store kept from earlier days goes. */
  async sweep(hashes) {
    const kept = await store();
    const wanted = new Set(hashes.map(keyOf));
    for (const { url } of (await kept?.keys().catch(() => [])) ?? []) if (!wanted.has(url)) await kept.delete(url);
  }

  /** This one is not handed out any more: nothing of it stays, neither here nor in the browser's store. */
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
      await (await store())?.delete(keyOf(sha256)).catch(() => {}); // a damaged copy would stay for ever
      Object.assign(one, { avatar: null, why: `the avatar did not come: ${error.message}`, until: performance.now() + PAUSE });
    }
  }

  async #response(sha256) {
    const kept = await store();
    const found = await kept?.match(keyOf(sha256)).catch(() => null);
    if (found) return found;
    const response = await this.#fetch(`splats/${sha256}`);
    if (response.ok) kept?.put(keyOf(sha256), response.clone()).catch(() => {}); // a full disk is no reason not to draw
    return response;
  }
}

/** The browser's store of files; null where it has none for this page (no https) or does not let us. */
async function store() {
  return globalThis.caches?.open(SPLATS_CACHE).catch(() => null) ?? null;
}

const keyOf = (sha256) => new URL(`../../splats/${sha256}`, import.meta.url).href;
