// Shared by the flat page and the headset: requests pairs of pictures, shows the newest, keeps the figures.

import { lightOf } from '../place/light.js';
import { LOOKS } from '../place/looks.js';
import { below, fromBox, fromFeet, fromPlaces } from '../place/shadow.js';
import { Framing } from '../space/framing.js';
import { onWire, turned } from '../space/light.js';
import { IDENTITY, fromPose, invert, multiply } from '../space/matrix.js';
import { watcher } from '../space/placing.js';
import { Figures } from '../stream/figures.js';
import { Pictures } from '../stream/pictures.js';
import { Names, headsOf } from './names.js';
import { Painter } from './painter.js';

const FIRST = 3000; // ms that the place, and drawing on this device, wait for the first picture
const PATIENCE = 10_000; // ms that the parts of extras wait for the first picture, unless the connection fails
const BY_SERVER = { by: 'server', reason: 'the server does not hand out the splats of this avatar' };
const SURPLUS = 3; // requests for each picture: the server draws the newest, and each costs both sides
const SLOWEST = 100; // ms between them while something moves, at most
const SHARE = 3; // pictures of which one shows what is beside the user's line of sight
const COMPLAINT = 4000; // ms for which an error of the server is shown

export class Stage {
  figures = new Figures();
  shownId = 0;
  onFrame = () => {}; // called with the views of each frame
  onPicture = () => {}; // called when a picture can be shown
  info = {}; // the JSON of the newest reply
  #shown = {}; // that of the newest pair on the display
  canHide = false; // whether the avatar's head can be hidden
  light = null; // of the server, for requests without a light
  here = null; // drawing on this device (show/here.js), once the server hands out an avatar
  sideFor = (side) => side; // pixels of a picture; smaller while the user speaks (voice/panel.js)
  names = new Names(); // of a room's people, over their heads
  begun; // resolves with the first picture, or when none comes soon
  #begin;
  #gl;
  #display = 0; // Hz of the headset; 0: not known
  #complaint = { text: '', until: 0 };
  #asked = 0; // ms, when the pair on the screen was requested
  #seen = true; // whether that pair has been drawn
  #opened = performance.now();
  #pictures = 0; // that came in
  #scene = 0; // number of calls of `clear`: pictures requested before show another place
  #painted = []; // inputs of the picture on the canvas
  #ask = () => 0; // request of the last frame

  constructor(gl, connection, settings) {
    this.connection = connection;
    this.settings = settings;
    this.#gl = gl;
    this.begun = new Promise((done) => (this.#begin = done));
    setTimeout(this.#begin, PATIENCE);
    this.painter = new Painter(gl);
    this.framing = new Framing();
    this.pictures = new Pictures({
      onDecoded: (ms) => {
        this.figures.add('decode', ms);
        this.onPicture();
      },
      onError: (text) => this.complain(text),
    });
    connection.addEventListener('reply', ({ detail }) => this.#received(detail));
    connection.addEventListener('complaint', ({ detail }) => {
      if (detail.code === 'no_pose') this.here?.refuse(detail.message);
      else this.complain(detail.message);
    });
    connection.addEventListener('state', () => {
      if (connection.state !== 'open') this.here?.clear();
      if (connection.state === 'waiting') this.#begin();
    });
  }

  /** Allow drawing on this device; `Here` is the class of show/here.js. */
  addHere(Here) {
    this.here = new Here(this.#gl, this.connection, this.settings);
    this.display = this.#display;
  }

  /** Refresh rate of the headset's display, Hz. */
  set display(hertz) {
    this.#display = hertz;
    if (this.here) this.here.choice.display = hertz;
  }

  /** Create everything on the GPU again, in the context `gl`, after the last one was lost. */
  restore(gl) {
    this.#gl = gl;
    this.painter = new Painter(gl);
    this.here?.restore(gl);
  }

  /** Note that the context is lost; nothing is drawn until `restore`. */
  lost() {
    this.here?.lost();
  }

  /**
   * Draw a frame for `views` [{transform, projection, viewport}] of `where` (a placing), and request the next picture,
   * every third of `also`, a placing or null, if somebody is in sight there. `drive` and `how` {alpha, transparent, room,
   * labels} as of `ask` and the painter; `framebuffer` null is the canvas, which `keeps` what was painted or, as in an
   * immersive session, is cleared for each frame; `around`: the light of a room that is not ours, or null; `asks` false:
   * request nothing; `deep`: request depths with pictures.
   * Returns the frame_id of the request, or 0.
   */
  frame(views, where, drive, { also = null, framebuffer = null, keeps = false, alpha, transparent = false, room, around, labels = () => [], asks = true, deep = false, now }) {
    this.onFrame(views);
    const light = this.#falling(where, around);
    const first = !this.shownId && performance.now() - this.#opened < FIRST;
    const here = !first && this.here?.draws(views, where, this.figures.rate('shown', now), now);
    this.#ask = (drive, now) =>
      here ? this.#askPoses(views, where, drive, now) : this.ask(views, where, drive, { also, alpha, light, deep, now });
    const sent = asks ? this.#ask(drive, now) : 0;
    this.advance(now);
    const look = this.settings.get('place');
    const bare = first || !this.painter.place.prepare(look);
    const own = here && this.here.people.size > 0;
    if (!keeps || own) this.#painted = [];
    else if (this.#shows(views, room, bare)) return sent;
    const hung = labels();
    this.painter.begin(framebuffer, transparent, bare ? LOOKS[look] : null);
    if (bare && !here) {
      const names = this.#named(views[0], framebuffer);
      views.forEach((view, i) => this.painter.view(view, i, { room: false, labels: [...names, ...hung] }));
      this.drawn();
      return sent;
    }
    const how = { room, seat: this.seat, keeps: framebuffer === null, mirror: [where, also].find((one) => one?.glass), look, blobs: this.#shadows(here, where, drive, now) };
    if (own) {
      // the pair stays, for a change back to pictures
      views.forEach((view, i) => this.painter.view(view, i, { ...how, picture: false }));
      const inside = where.view === 'own' && this.canHide;
      this.here.face.now = saidBy(drive);
      const age = this.here.draw(views, framebuffer, where, { inside, light, servers: this.light, now });
      if (age !== null) this.figures.show(now - age, performance.now());
      const names = this.names.labels(this.here.heads(where), views[0], this.painter, framebuffer === null);
      views.forEach((view) => this.painter.labels(view, [...names, ...hung]));
    } else {
      const names = this.#named(views[0], framebuffer);
      views.forEach((view, i) => this.painter.view(view, i, { ...how, labels: [...names, ...hung] }));
      this.drawn();
    }
    return sent;
  }

  /** Return whether frames before the next picture would show nothing new. */
  rests(now) {
    return this.shownId > 0 && !this.pictures.ready && (this.here?.choice.rests(now) ?? true);
  }

  /** Return the milliseconds on average after which movements of others are seen, from when the server had them. */
  late(now) {
    const { figures } = this;
    const rate = figures.rate('shown', now);
    if (!rate) return 0;
    const poses = this.renderedBy.by === 'here'; // mouths are the newest (stream/pose.js)
    // half a period until the other's own picture, whose pose all see in theirs, and half until the next one here
    return (poses ? figures.median('round trip') : figures.median('age') - figures.median('server wait')) + 1000 / rate;
  }

  /** Return the milliseconds between two requests while something moves. */
  pause(now) {
    return Math.min(SLOWEST, 1000 / (SURPLUS * this.figures.rate('shown', now)));
  }

  /** The people of the room, as the server told last: [{name, avatar, you, ...}]. */
  get people() {
    return this.info.room?.people ?? this.here?.people.room?.people ?? [];
  }

  /** The user's own space in the room that its people share, a matrix; alone both are the same. */
  get seat() {
    const place = this.info.room?.place ?? this.here?.people.room?.place;
    return place ? fromPose(place) : IDENTITY;
  }

  /** The joints of all heads [x, y, z] in a room, in the user's space: {own, others}. */
  get heads() {
    const here = this.here?.choice.here && this.here.people.size > 0;
    const found = here ? this.here.heads({ shown: IDENTITY }) : headsOf(this.info.room, { shown: IDENTITY });
    return { own: found.find(({ you }) => you)?.head ?? null, others: found.filter(({ you }) => !you).map(({ head }) => head) };
  }

  /** The box about the user's own person in a room, by the head; null if that is not known. */
  get ownBox() {
    const [x, y, z] = this.heads.own ?? [];
    return x === undefined ? null : [x - 0.2, y - 1.5, z - 0.2, x + 0.2, y + 0.17, z + 0.2];
  }

  /** Return the names over the heads in the pairs on the display, for an eye. */
  #named(eye, framebuffer) {
    const heads = this.painter.shownAs.flatMap(({ info, where }) => headsOf(info.room, where));
    return this.names.labels(heads, eye, this.painter, framebuffer === null);
  }

  /** Repeat the last frame's request with another `drive`, before the next frame. Returns the frame_id, or 0. */
  askAgain(drive, now) {
    return this.#ask(drive, now);
  }

  /**
   * Return whether the canvas shows these inputs already, and keep them. A picture is not drawn twice, as the server
   * may run on the same machine.
   */
  #shows(views, room, bare) {
    const eyes = views.flatMap(({ transform, projection, viewport }) => [...transform, ...projection, ...Object.values(viewport)]);
    const wanted = [this.painter, ...this.painter.shownAs, this.settings.get('place'), room, bare, ...this.seat, ...eyes];
    const same = wanted.length === this.#painted.length && wanted.every((value, i) => value === this.#painted[i]);
    this.#painted = wanted;
    return same;
  }

  /** Return the light in the avatar's own space: `around`, or that of the place; null: the server's. */
  #falling(where, around) {
    if (around === undefined) {
      const falls = lightOf(this.settings.get('place'));
      around = falls && turned(falls, invert(this.seat));
    }
    if (!around || !this.settings.get('light')) return null;
    return where.glass ? around : turned(around, invert(where.shown)); // a mirror's user stands in the room itself
  }

  /** Return the shadows of all people on the floor of the room. */
  #shadows(here, where, { pose, tracking }, now) {
    if (this.settings.get('place') === 'plain') return [];
    const shown = where.glass ? this.seat : multiply(this.seat, where.shown); // a mirror shows the floor under its user
    if (here && this.here.people.size) return this.here.shadows(shown, now);
    const { box, feet, room } = this.painter.shownAs.length ? this.#shown : {};
    if (room) return fromPlaces(standing(room), shown);
    if (feet) return fromFeet(feet, shown);
    const trans = pose?.trans;
    const root = trans ? [trans[0], trans[2]] : tracking?.head ? below(tracking.head) : null;
    return box ? fromBox(box, shown, root) : [];
  }

  /** Show a message to the user for some seconds. */
  complain(text) {
    this.#complaint = { text, until: performance.now() + COMPLAINT };
  }

  /** The current message to the user; empty while all is well. */
  get notice() {
    if (this.connection.reason) return this.connection.reason;
    return performance.now() < this.#complaint.until ? this.#complaint.text : '';
  }

  /** How much a slow link reduces the pictures, as a sentence; empty if it does not. */
  get link() {
    const { why, scale } = this.info.detail ?? {};
    if (why !== 'link' || this.connection.state !== 'open') return '';
    const less = scale < 1 ? `${Math.round(100 * scale)} % of their size` : 'lower quality';
    return `The connection is slow: pictures are sent at ${less}.`;
  }

  /** Forget the picture, for another avatar or another place. */
  clear() {
    this.#scene++;
    this.framing.forget();
    this.painter.forget();
  }

  /**
   * Request a picture for `views` [{transform, projection}]. `drive`: {tracking, t} or {pose} of the avatar; `light` on
   * it; `alpha` false: a mirror is opaque. Returns the frame_id; 0 if nothing was sent.
   */
  ask(views, where, drive, { also = null, alpha, light = null, deep = false, now }) {
    const age = (this.figures.median('age') ?? 100) / 1000;
    const sample = drive.tracking ?? null;
    const side = this.sideFor(this.settings.get('size'), this.info.times, now, this.framing.seen);
    const frame = (one, always) => this.framing.frame(views, one, sample, side, age, now, always);
    const framed = (also && this.#pictures % SHARE === 0 && frame(also, false)) || frame(where, true);
    const { mirror, glass, view } = framed?.where ?? where;
    const clear = alpha || !glass;
    const request = {
      ...drive,
      t: drive.t ?? now,
      quality: this.settings.get('quality'),
      crop: true,
      box: true,
      ...(clear ? { alpha: 'straight' } : {}),
      ...(clear && deep ? { depth: true } : {}),
      ...(light ? { light: onWire(light) } : {}),
      ...(mirror ? { mirror: true } : {}),
      ...(view === 'own' && this.canHide ? { hide: ['head'] } : {}),
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
    if (newest.asked.scene !== this.#scene) return this.pictures.close(newest); // decoded while the place changed
    const started = performance.now();
    this.painter.upload(newest);
    this.#shown = newest.info;
    this.pictures.close(newest);
    this.figures.add('upload', performance.now() - started);
    this.shownId = newest.id;
    this.#begin();
    this.#asked = newest.asked.sent;
    this.#seen = false;
    return true;
  }

  /** Note that the frame is drawn: its pair is on the screen now. */
  drawn() {
    if (this.#seen) return;
    this.#seen = true;
    this.figures.show(this.#asked, performance.now());
  }

  /** Where the avatars are drawn, and why: `drawn` of the figures. */
  get renderedBy() {
    return this.here?.stats() ?? BY_SERVER;
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
      place: painter.place.counts,
      drawn: this.renderedBy,
      link: this.link,
      server: Object.fromEntries(
        figures.names().filter((name) => name.startsWith('server ')).map((name) => [name.slice(7), figures.median(name)]),
      ),
    };
  }

  /** Request a tiny picture of nothing while the avatar is out of sight: its solver needs every sample. */
  #keepTracking(views, request) {
    const away = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, -1000, 0, 0, 0, 1]; // looks away from the room
    const eyes = views.map(() => ({ viewmat: away, K: [16, 16, 8, 8] }));
    return this.connection.send({ eyes, size: [16, 16], ...request }, null);
  }

  #askPoses(views, where, drive, now) {
    const faces = drive.tracking ? { faces: [watcher(views, where)] } : {};
    return this.connection.send({ ...drive, t: drive.t ?? now, want: 'pose', ...faces }, { scene: this.#scene, said: saidBy(drive) });
  }

  #received({ reply, buffer, asked, sent, ms }) {
    this.info = reply.info;
    this.figures.reply(reply.info, ms);
    if (reply.bodies) {
      this.here.arrived(reply, asked.said, performance.now());
      this.shownId = reply.id;
      return;
    }
    if (asked?.scene !== this.#scene) return; // requested without the avatar in sight, or before `clear`
    this.#pictures++;
    this.framing.learn(reply.info.box, asked, standing(reply.info.room));
    this.pictures.offer(reply, buffer, { ...asked, sent });
  }
}

/** Return the people of a reply's room that have a valid position, `at` [x, y, z]. */
const standing = (room) => (Array.isArray(room?.people) ? room.people : []).filter(({ at }) => Array.isArray(at) && at.length === 3 && at.every(Number.isFinite));

/** Return the expression of a drive, if any. */
const saidBy = ({ pose, tracking }) => (pose ?? tracking)?.expression;
