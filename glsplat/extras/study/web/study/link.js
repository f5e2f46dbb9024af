// Messages of the study's pages: each is a POST of JSON, answered with the state.

const SERVER = new URL('..', location.href); // the page is SERVER/vr/..., also behind a proxy that moves it
const PAUSES = [300, 600, 1200, 2500]; // ms between attempts

/** A refusal by the server, with its code and HTTP status; status 0: no answer. */
class Refusal extends Error {
  constructor(status, code, message, wait = 0) {
    super(message);
    Object.assign(this, { status, code, wait });
  }

  /** Whether a retry may succeed: the disk was full, the server away or busy. */
  get passes() {
    return this.status === 0 || this.status === 429 || this.status >= 500;
  }
}

export class Link {
  #secret;
  #token;

  constructor({ secret, token }) {
    this.#secret = secret;
    this.#token = token;
  }

  /** Return the response of one POST. Throws a Refusal. */
  async #post(path, message) {
    const headers = { 'Content-Type': 'application/json', 'X-Glsplat-Study': this.#secret };
    if (this.#token) headers.Authorization = `Bearer ${this.#token}`;
    let response;
    try {
      const body = JSON.stringify(message);
      response = await fetch(new URL(path, SERVER), { method: 'POST', headers, body, cache: 'no-store', credentials: 'omit' });
    } catch {
      throw new Refusal(0, 'lost', 'the server does not answer');
    }
    if (response.ok) return response;
    const text = await response.text().catch(() => '');
    let error = { code: 'refused', message: text.trim() || `the server refused (${response.status})` };
    try {
      error = JSON.parse(text).error ?? error;
    } catch {
      // a line of text
    }
    throw new Refusal(response.status, error.code, error.message, 1000 * (Number(response.headers.get('Retry-After')) || 0));
  }

  /** Return the JSON of an answer. Throws a Refusal. */
  async ask(path, message) {
    const response = await this.#post(path, message);
    return response.json().catch(() => {
      throw new Refusal(0, 'lost', 'the connection was lost');
    });
  }

  /** Return a picture as a Blob, or null. Throws a Refusal. */
  async picture(path) {
    const response = await this.#post(path, {});
    return response.status === 204 ? null : response.blob();
  }
}

/** Wait before retry number `count` after a `refusal`. */
export function pause(count, refusal) {
  const ms = Math.max(refusal?.wait ?? 0, PAUSES[Math.min(count, PAUSES.length - 1)]);
  return new Promise((done) => setTimeout(done, ms));
}

/** Return {study, token} of the address behind "#"; keep them in this tab alone and remove them from the address. */
export function brought(key) {
  const hash = new URLSearchParams(location.hash.slice(1));
  if (hash.get('study')) {
    sessionStorage.setItem(key, JSON.stringify({ secret: hash.get('study'), token: hash.get('token') ?? '' }));
    history.replaceState(null, '', location.pathname + location.search);
  }
  return JSON.parse(sessionStorage.getItem(key) ?? '{"secret":"","token":""}');
}
