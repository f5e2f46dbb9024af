// What the page keeps in the browser. A browser that keeps nothing (private windows, blocked storage) is no error.

/** Name of the browser's cache of avatars that the server hands out. */
export const SPLATS_CACHE = 'glsplat.splats';

/** The browser's localStorage, or null where it may not be touched. */
export function browserStorage() {
  try {
    return globalThis.localStorage ?? null;
  } catch {
    return null;
  }
}

/** The JSON object kept under `key`; an empty object where there is none that can be read. */
export function readKept(storage, key) {
  try {
    const value = JSON.parse(storage?.getItem(key) ?? '{}');
    return value !== null && typeof value === 'object' && !Array.isArray(value) ? value : {};
  } catch {
    return {};
  }
}

/** Keep a JSON object under `key`. Returns whether it was kept. */
export function keep(storage, key, value) {
  try {
    storage.setItem(key, JSON.stringify(value));
    return true;
  } catch {
    return false;
  }
}
