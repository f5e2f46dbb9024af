// What both ways of looking share: ask for a pair, take the newest that came, put it on the screen, keep the figures.

import { Framing } from '../space/framing.js';
import { Figures } from '../stream/figures.js';
import { Pictures } from '../stream/pictures.js';
import { Painter } from './painter.js';

const COMPLAINT = 4000; // ms for which a server's complaint is repeated to the user

export class Stage {
  figures = new Figures();
  shownId = 0;
  info = {}; // the JSON of the newest reply
  canHide = false; // whether the avatar has a head that can be left out
  #complaint = { text: '', until: 0 };
  #asked = 0; // when the pair on the screen was asked for
  #seen = true; // whether that pair has been drawn
  #scene = 0; // counts what `clear` ended: pictures asked for before are of another place

  /** `inWorker` false decodes on the page's thread, to compare. */
  constructor(gl, connection, settings, { inWorker = true } = {}) {
    this.connection = connection;
    this.settings = settings;
    this.painter = new Painter(gl);
    this.framing = new Framing();
    this.pictures = new Pictures({
      inWorker,
      onDecoded: (ms) => this.figures.add('decode', ms),
      onError: (text) => this.complain(text),
    });
    connection.addEventListener('reply', ({ detail }) => this.#received(detail));
    connection.addEventListener('complaint', ({ detail }) => this.complain(detail.message));
  }

  /** A new context after a lost one: everything on the GPU is made anew. */
  restore(gl) {
    this.painter = new Painter(gl);
  }

  /** Tell the user for some seconds. */
  complain(text) {
    this.#complaint = { text, until: performance.now() + COMPLAINT };
  }

  /** What the user has to know just now, in words; empty while all is well. */
  get notice() {
    if (this.connection.reason) return this.connection.reason;
    return performance.now() < this.#complaint.until ? this.#complaint.text : '';
  }

  /** Forget what was shown: another avatar, another place. */
  clear() {
    this.#scene++;
    this.framing.forget();
    this.painter.forget();
  }

  /**
   * Send a request for what `views` [{transform, projection}] are to see of the avatar, `drive` {tracking, t} or
   * {pose} says how it stands. Returns its frame_id; 0 where nothing was sent.
   */
  ask(views, where, drive, { alpha, now }) {
    const age = (this.figures.median('age') ?? 100) / 1000;
    const sample = drive.tracking ?? null;
    const framed = this.framing.frame(views, where, sample, this.settings.get('size'), age, now);
    const request = {
      ...drive,
      t: drive.t ?? now,
      quality: this.settings.get('quality'),
      crop: true,
      box: true,
      ...(alpha ? { alpha: 'straight' } : {}),
      ...(where.mirror ? { mirror: true } : {}),
      ...(where.view === 'own' && this.canHide ? { hide: ['head'] } : {}),
    };
    if (framed) {
      const asked = { ...framed, scene: this.#scene };
      return this.connection.send({ eyes: framed.eyes, size: framed.size, ...request }, asked);
    }
    return sample ? this.#keepTracking(views, request) : 0;
  }

  /** Upload the newest decoded pair, if there is one. Call within the frame that draws it. */
  advance(now) {
    this.figures.frame(now);
    const newest = this.pictures.take();
    if (!newest) return false;
    const started = performance.now();
    this.painter.upload(newest);
    this.pictures.close(newest);
    this.figures.add('upload', performance.now() - started);
    this.shownId = newest.id;
    this.#asked = newest.asked.sent;
    this.#seen = false;
    return true;
  }

  /** The frame is drawn: the pair on the screen is shown from here on. */
  drawn() {
    if (this.#seen) return;
    this.#seen = true;
    this.figures.show(this.#asked, performance.now());
  }

  /** The figures for `window.glsplat.stats()`. */
  stats(now) {
    const { connection, figures, pictures, painter } = this;
    const round = (value) => (value === null ? null : Math.round(value * 10) / 10);
    return {
      state: connection.state,
      problem: connection.problem,
      shown: figures.shown,
      shownId: this.shownId,
      sentId: connection.sentId,
      fps: round(figures.rate('shown', now)),
      frameRate: round(figures.rate('frames', now)),
      ageMs: round(figures.median('age')),
      ageP95Ms: round(figures.p95('age')),
      rttMs: round(figures.median('round trip')),
      decodeMs: round(figures.median('decode')),
      uploadMs: round(figures.median('upload')),
      dropped: pictures.dropped,
      droppedByServer: this.info.dropped ?? 0,
      reconnects: Math.max(0, connection.opened - 1),
      bitmaps: pictures.open,
      textures: painter.textures,
      server: Object.fromEntries(
        figures.names().filter((name) => name.startsWith('server ')).map((name) => [name.slice(7), figures.median(name)]),
      ),
    };
  }

  /** The avatar is out of sight, but its solver wants every sample: a picture of nothing, as small as there is. */
  #keepTracking(views, request) {
    const away = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, -1000, 0, 0, 0, 1]; // looks away from the room
    const eyes = views.map(() => ({ viewmat: away, K: [16, 16, 8, 8] }));
    return this.connection.send({ eyes, size: [16, 16], ...request }, null);
  }

  #received({ reply, buffer, asked, sent, ms }) {
    this.info = reply.info;
    this.figures.reply(reply.info, ms);
    if (asked?.scene !== this.#scene) return; // of nothing in sight, or of another place
    this.framing.learn(reply.info.box, asked);
    this.pictures.offer(reply, buffer, { ...asked, sent });
  }
}
