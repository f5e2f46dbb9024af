// The WebSocket of docs/protocol.md: reconnects, acknowledges, and gives reasons in words when it does not open.

import { parseReply } from './reply.js';
import { openSocket } from './socket.js';

const SERVER = new URL('..', location.href); // the page is SERVER/vr/, also behind a proxy that moves it
const PAUSES = [250, 500, 1000, 2000, 4000]; // ms between attempts
const MOST_BUFFERED = 128 * 1024; // unsent bytes above which requests are dropped
const LONGEST = 60_000; // ms; longest time that is reported
const UNDECODED = 3; // failed key frames after which no video is requested
const DATAGRAMS = typeof WebTransport === 'undefined' ? {} : { datagrams: true };
const REMEMBERED = 2048; // requests whose replies may still come: 20 s at 90 Hz

/**
 * Events: `state` (its `state` or `reason` changed), `reply` (detail {reply, buffer, asked, ms}), `complaint` (detail
 * {code, message} of the server's), `talk` (detail: another client's message), `offer` (detail: the answer of GET /session). States: off, connecting, open,
 * waiting.
 */
export class Connection extends EventTarget {
  state = 'off';
  reason = ''; // in words; empty while all is well
  problem = ''; // token, full, held-off, refused, lost: for programs
  sentId = 0;
  receivedId = 0;
  received = 0;
  opened = 0; // number of times that it opened
  resume = ''; // token with which the next connection resumes as the same person in a room
  awake = () => true; // called before each attempt; while it returns false, only `hurry` connects
  #options;
  #token = null;
  #socket = null;
  #timer = 0;
  #failures = 0;
  #asked = new Map(); // by frame_id: {asked, sent}
  #acknowledged = 0; // newest frame_id received on this connection
  parsePoses = null; // reads replies in poses; set by show/here.js, which asks for them
  #videos = []; // codecs of the server
  #codecs = null; // codecs that this browser decodes; null: not known yet
  #lost = false; // the video needs a key frame
  #undecoded = 0; // key frames that failed to decode, in a row
  #arrival = null; // {age, at} of the newest picture, ms, until it is reported

  /** `options()` gives the query of /ws at each attempt: {avatar, height, span, window}, those that are set. */
  constructor(options) {
    super();
    this.#options = options;
  }

  /** Video codecs that the server has, as /session says. */
  set videos(names) {
    this.#videos = names;
    if (!names.length || this.#codecs) return;
    this.#codecs = [];
    import('./video.js').then(({ decodable }) => decodable()).then((codecs) => (this.#codecs = codecs), () => {});
  }

  set token(token) {
    this.#token = token || null;
  }

  /** Headers of each HTTP request: the token. */
  get headers() {
    return this.#token ? { Authorization: `Bearer ${this.#token}` } : {};
  }

  /** Return the URL of a path of the server. */
  address(path) {
    return new URL(path, SERVER);
  }

  /** GET a path of the server, or another `method`, with the token. */
  fetch(path, { method = 'GET' } = {}) {
    return fetch(this.address(path), { method, headers: this.headers, cache: 'no-store', credentials: 'omit' });
  }

  /** Connect, or connect anew at once, with the options of now. */
  restart() {
    this.stop();
    this.#connect();
  }

  /** Make the next attempt now, if one is due later; `reason` stays until it has ended. */
  hurry() {
    if (this.state !== 'waiting') return;
    clearTimeout(this.#timer);
    this.#connect();
  }

  stop() {
    clearTimeout(this.#timer);
    const socket = this.#socket;
    this.#socket = null;
    this.#asked.clear();
    socket?.close(1000);
    this.#become('off', '', '');
  }

  /**
   * Send a request, adding v, frame_id and ack. Return its frame_id, 0 if it was dropped. `asked` comes back with the
   * reply.
   */
  send(request, asked) {
    if (this.state !== 'open' || this.#socket.readyState !== WebSocket.OPEN) return 0; // it may be closing already
    if (this.#socket.bufferedAmount > MOST_BUFFERED) return 0;
    const frameId = ++this.sentId;
    this.#asked.set(frameId, { asked, sent: performance.now() });
    if (this.#asked.size > REMEMBERED) this.#asked.delete(this.#asked.keys().next().value);
    const able = { ...this.#watching(), ...(this.#socket.openDatagrams && DATAGRAMS) };
    this.#socket.send(JSON.stringify({ v: 1, frame_id: frameId, ...this.#acknowledging(), ...able, ...request }));
    return frameId;
  }

  /** Send a message to other clients of the room (docs/protocol.md, 2.2). */
  talk(message) {
    if (this.state === 'open') this.#socket.send(JSON.stringify({ talk: message }), true);
  }

  /** Return the field with the codecs that both sides have, if any. */
  #watching() {
    const codecs = this.#codecs?.filter((codec) => this.#videos.includes(codec));
    if (!codecs?.length) return {};
    return { video: { codecs, ...(this.#lost && { key: true }) } };
  }

  /**
   * Return the fields that acknowledge the newest picture and, once, report how it arrived, for the server's rate
   * control.
   */
  #acknowledging() {
    const fields = { ack: this.#acknowledged };
    if (this.#arrival) {
      const { age, at } = this.#arrival;
      fields.arrival = { age: Math.min(age, LONGEST), held: Math.min(performance.now() - at, LONGEST) };
      this.#arrival = null;
    }
    return fields;
  }

  #connect() {
    this.#become('connecting', this.#failures ? this.reason : '', this.#failures ? this.problem : '');
    const url = this.address('ws');
    url.protocol = location.protocol === 'https:' ? 'wss:' : 'ws:';
    const asked = this.#options();
    for (const [name, value] of Object.entries({ ...asked, resume: asked.room && this.resume })) {
      if (value !== null && value !== undefined && value !== '') url.searchParams.set(name, value);
    }
    const protocols = ['glsplat.v1', ...(this.#token ? [`token.${this.#token}`] : [])];
    const socket = (this.#socket = openSocket(url, protocols));
    let wasOpen = false;
    socket.onopen = () => {
      if (socket !== this.#socket) return;
      wasOpen = true;
      this.#acknowledged = 0;
      this.#arrival = null;
      this.#lost = false;
      this.opened++;
      this.#become('open', '', '');
    };
    socket.onmessage = ({ data }) => {
      if (socket === this.#socket) this.#receive(data);
    };
    socket.onclose = (event) => {
      if (socket === this.#socket) this.#closed(event, wasOpen);
    };
  }

  #receive(data) {
    if (typeof data === 'string') {
      const { error, talk } = JSON.parse(data);
      if (error) this.dispatchEvent(new CustomEvent('complaint', { detail: error }));
      if (talk) this.dispatchEvent(new CustomEvent('talk', { detail: talk }));
      return;
    }
    let reply;
    try {
      reply = isOfPoses(data) ? this.parsePoses(data) : parseReply(data);
    } catch (error) {
      this.dispatchEvent(new CustomEvent('complaint', { detail: { code: 'bad_reply', message: error.message } }));
      return;
    }
    if (reply.info?.video) {
      const { key } = reply.info.video;
      reply.lost = () => {
        this.#lost = true;
        if (key && ++this.#undecoded >= UNDECODED) this.#codecs = []; // JPEGs from now on
      };
      reply.decoded = () => {
        this.#undecoded = 0;
      };
      if (key) this.#lost = false;
    }
    if (reply.info?.datagrams) this.#openDatagrams(reply.info.datagrams);
    if (reply.info?.room?.resume) this.resume = reply.info.room.resume;
    this.#failures = 0; // not on opening: a server may accept and drop at once
    if (reply.id <= this.#acknowledged || reply.id > this.sentId) return; // late, or never requested
    this.received++;
    this.receivedId = this.#acknowledged = reply.id;
    const found = this.#asked.get(reply.id);
    const now = performance.now();
    if (found) this.#arrival = { age: now - found.sent, at: now };
    // acknowledge now, so that a request that waits for the window is drawn before the next one is sent
    const listens = this.#socket.readyState === WebSocket.OPEN;
    if (listens && this.sentId > reply.id) this.#socket.send(JSON.stringify({ v: 1, ...this.#acknowledging() }));
    for (const id of this.#asked.keys()) {
      if (id > reply.id) break;
      this.#asked.delete(id); // once a reply has come, none to an earlier request will
    }
    if (!found) return;
    const detail = { reply, buffer: data, asked: found.asked, sent: found.sent, ms: now - found.sent };
    this.dispatchEvent(new CustomEvent('reply', { detail }));
  }

  /** Open the datagrams that the server offers, at the same host and port by UDP. */
  #openDatagrams({ path, sha256 }) {
    const address = this.address(path);
    address.protocol = 'https:';
    this.#socket.openDatagrams?.(address, sha256);
  }

  async #closed(event, wasOpen) {
    this.#socket = null;
    this.#asked.clear();
    const pause = PAUSES[Math.min(this.#failures++, PAUSES.length - 1)];
    const [problem, reason, least] = wasOpen ? closing(event) : await this.#refusal();
    if (this.#socket || this.state === 'off') return; // another attempt was faster
    this.#become('waiting', reason, problem);
    if (problem === 'token') return; // no attempt until the user enters another one
    this.#timer = setTimeout(() => this.awake() && this.#connect(), Math.max(pause, least ?? 0));
  }

  /** Find out why the handshake failed: browsers hide it from scripts, so the page asks /session. */
  async #refusal() {
    try {
      const response = await this.fetch('session');
      if (response.status === 401) {
        return ['token', this.#token ? 'the token is wrong' : 'this server needs a token'];
      }
      if (response.status === 429) {
        const seconds = Number(response.headers.get('Retry-After')) || 10;
        return ['held-off', `too many attempts from this address; the next one in ${seconds} s`, seconds * 1000];
      }
      if (response.ok) {
        const offer = await response.json();
        this.dispatchEvent(new CustomEvent('offer', { detail: offer })); // the chosen avatar or room may be gone
        if (offer.avatars?.length === 0) return ['refused', 'the server has no avatar for you now; trying again', 5000];
        if (offer.full) return ['full', 'the server is full; trying again', 2000];
        const words = roomRefusal(this.#options(), offer.rooms ?? []);
        if (words) return ['refused', words, 2000];
        return ['refused', 'the server accepts no connections now; trying again'];
      }
      return ['refused', `the server refused the connection (${(await response.text()).trim() || response.status})`];
    } catch {
      return ['lost', 'the server does not answer; trying again'];
    }
  }

  #become(state, reason, problem) {
    if (state === this.state && reason === this.reason) return;
    Object.assign(this, { state, reason, problem });
    this.dispatchEvent(new Event('state'));
  }
}

/** Return whether a reply has poses: it has no pictures then (docs/protocol.md, section 4). */
const isOfPoses = (data) => data.byteLength > 8 && new DataView(data).getUint8(8) === 0;

/** Return why a room may have refused the user; empty without a room. */
function roomRefusal({ room, name }, rooms) {
  if (!room) return '';
  const found = rooms.find((one) => one.name === room);
  if (!found) return `this server has no room "${room}"`;
  if (found.people >= found.seats) return 'the room is full; trying again';
  return name ? `the name "${name}" may be taken in this room: choose another` : 'the room accepts nobody now; trying again';
}

/** Return what a close code of section 6 means: [problem, words, ms to wait at least]. */
function closing({ code, reason }) {
  const words = reason ? `: ${reason}` : '';
  if (code === 1001) return ['lost', `${reason || 'the server is shutting down'}; trying again`];
  if (code === 1008) return ['refused', `the server ended the connection${words}`, 2000];
  return ['lost', `connection lost${words}; trying again`];
}
