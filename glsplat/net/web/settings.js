// The user's settings: validated, kept in the browser, announced when they change.

import { PLACES } from './place/looks.js';

const KEY = 'glsplat.settings';

/** Names of people and avatars, or ''. Twin: glsplat/net/options.py. */
export const NAME = /^(?:[\p{L}\p{N}](?:[\p{L}\p{N}_ .'-]{0,30}[\p{L}\p{N}_.])?)?$/u;

const choice = (value, options = []) => ({ kind: 'choice', value, options });
const number = (value, least, most) => ({ kind: 'number', value, least, most });
const flag = (value) => ({ kind: 'flag', value });
const text = (value, pattern) => ({ kind: 'text', value, pattern });
const plain = (values) => values.map((value) => ({ value, label: String(value) }));

/** Every setting with its default. Options that depend on the server come by setOptions(). */
function table() {
  return {
    view: choice('mirror', [
      { value: 'mirror', label: 'Mirror' },
      { value: 'facing', label: 'Facing me' },
      { value: 'own', label: 'Own body' },
    ]),
    place: choice('day', PLACES), // surroundings of the avatar
    light: flag(true), // whether its light falls on avatars with a surface
    avatar: choice(''),
    room: choice('', [{ value: '', label: 'None: alone' }]),
    name: text('', NAME), // shown to others in a room
    size: choice(1024, plain([512, 768, 1024, 1536])), // pixels, both sides of an eye's picture
    quality: number(80, 50, 95), // JPEG quality
    drawn: choice('auto', [
      { value: 'auto', label: 'Automatic' },
      { value: 'server', label: 'The server' },
      { value: 'here', label: 'This device' },
    ]), // where the avatars are drawn
    driver: choice('motion:idle', [
      { value: 'rest', label: 'Standing still' },
      { value: 'file', label: 'My recording…' },
    ]),
    stereo: flag(false),
    height: { ...number(null, 0.5, 2.8), optional: true }, // the user's stature in metres
    figures: flag(false),
    drawer: flag(false), // whether the panel is open
  };
}

/** The settings by name. Events: 'change' (detail {name, value}) and 'options' (detail {name}). */
export class Settings extends EventTarget {
  #table = table();
  #wishes = {};
  #storage;

  /** `asked`: values by name that win over the kept ones, such as those of the page's address. */
  constructor(storage = browserStorage(), asked = {}) {
    super();
    this.#storage = storage;
    const kept = { ...readKept(storage, KEY), ...asked };
    for (const [name, entry] of Object.entries(this.#table)) {
      this.#wishes[name] = Object.hasOwn(kept, name) && plausible(entry, kept[name]) ? kept[name] : entry.value;
    }
  }

  /** The names of all settings. */
  get names() {
    return Object.keys(this.#table);
  }

  /**
   * Return the value in force. A choice that is not offered (yet) gives the default, else the first offered, else ''.
   */
  get(name) {
    const entry = this.#entry(name);
    if (entry.kind !== 'choice') return this.#wishes[name];
    const offered = (value) => entry.options.some((option) => option.value === value);
    return [this.#wishes[name], entry.value].find(offered) ?? entry.options[0]?.value ?? '';
  }

  /** Return whether the user chose the value in force, now or earlier; otherwise it is the default. */
  chosen(name) {
    const entry = this.#entry(name);
    return this.#wishes[name] !== entry.value && this.get(name) === this.#wishes[name];
  }

  /** Set the default of a setting. */
  setDefault(name, value) {
    const entry = this.#entry(name);
    const before = this.get(name);
    if (this.#wishes[name] === entry.value) this.#wishes[name] = value;
    entry.value = value;
    this.#announce(name, before);
    this.dispatchEvent(new CustomEvent('options', { detail: { name } }));
  }

  /** Set and keep a value; choices and numbers may be text. Return false for a value that is not allowed. */
  set(name, value) {
    const entry = this.#entry(name);
    const [right, parsed] = parse(entry, value);
    if (!right) return false;
    const before = this.get(name);
    this.#wishes[name] = parsed;
    this.#keep();
    this.#announce(name, before);
    return true;
  }

  /** Return the options of a choice: [{value, label}]; null for numbers and flags. */
  options(name) {
    return this.#entry(name).options ?? null;
  }

  /** Offer other options; an earlier choice among them is in force again. */
  setOptions(name, options) {
    const entry = this.#entry(name);
    if (entry.kind !== 'choice') throw new RangeError(`${name} is no choice: it has no options`);
    const before = this.get(name);
    entry.options = options.map(({ value, label }) => ({ value, label: label ?? String(value) }));
    this.dispatchEvent(new CustomEvent('options', { detail: { name } }));
    this.#announce(name, before);
  }

  #entry(name) {
    if (!Object.hasOwn(this.#table, name)) throw new RangeError(`there is no setting ${JSON.stringify(name)}`);
    return this.#table[name];
  }

  #announce(name, before) {
    const value = this.get(name);
    if (value !== before) this.dispatchEvent(new CustomEvent('change', { detail: { name, value } }));
  }

  #keep() {
    const kept = { ...this.#wishes };
    if (kept.driver === 'file') delete kept.driver; // a reloaded page has no file
    keep(this.#storage, KEY, kept);
  }
}

/** Return whether a kept value is of the right kind; options may not be known yet and are checked later. */
function plausible(entry, value) {
  if (entry.kind === 'choice') return ['string', 'number'].includes(typeof value);
  if (entry.kind === 'text') return typeof value === 'string' && entry.pattern.test(value);
  return typeof value !== 'string' && parse(entry, value)[0];
}

/** Return [allowed, value] for the value of a program or a control. */
function parse(entry, value) {
  if (entry.kind === 'flag') return [typeof value === 'boolean', value];
  if (entry.kind === 'text') {
    const words = String(value ?? '').trim();
    return [entry.pattern.test(words), words];
  }
  if (entry.kind === 'choice') {
    const found = entry.options.find((option) => String(option.value) === String(value));
    return [found !== undefined, found?.value];
  }
  const blank = value === null || (typeof value === 'string' && value.trim() === '');
  if (blank) return [entry.optional === true, null];
  const parsed = typeof value === 'string' ? Number(value) : value;
  return [typeof parsed === 'number' && parsed >= entry.least && parsed <= entry.most, parsed];
}

// A browser that keeps nothing (private windows, blocked storage) is no error.

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
