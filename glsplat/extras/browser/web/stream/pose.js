// Parses replies in poses (docs/protocol.md, section 4.1), checking every length, and interpolates them for the
// display. Twin: glsplat/net/codec/body.py.

const MAGIC = 0x5256; // "VR", little endian
const HEAD = 108; // bytes of a body before its rotations
const SHAPES = 52; // shapes of ARKit
const MOUTH = [...Array.from({ length: 27 }, (_, i) => 14 + i), 51]; // of jawForward to mouthUpperUpRight, tongueOut
const SMALLEST = 1e-5; // of a scale
const [YOU, EXPRESSION, TRANSLATIONS] = [1, 2, 4];
const KEPT = 6; // samples of a person
const LATEST = 150; // ms; largest delay of other people
const DRIFT = 0.001; // ms per ms; largest drift between two clocks
const TORN = 1000; // ms; a larger jump restarts a clock

/**
 * {id, info, bodies: [{key, you, frameId, at, t, opacity, sha256, place: {translation, rotation, scale}, root, joints,
 * expression | null, translations | null}]}; `joints` are x y z w a joint, unit. Throws an Error that says what is
 * wrong.
 */
export function parsePoses(buffer) {
  const view = new DataView(buffer);
  if (view.byteLength < 14 || view.getUint16(0, true) !== MAGIC || view.getUint16(2, true) !== 1 || view.getUint8(8)) {
    throw new Error('not a pose reply of version 1');
  }
  const start = 13 + view.getUint32(9, true);
  if (start >= view.byteLength) throw new Error('truncated pose reply');
  const info = json(new Uint8Array(buffer, 13, start - 13));
  if (info?.want !== 'pose') throw new Error('the reply has no poses');
  const bodies = [];
  let offset = start + 1;
  for (let n = view.getUint8(start); n > 0; n--) {
    const size = offset + HEAD <= view.byteLength ? view.getUint16(offset, true) : 0;
    if (size < HEAD || offset + size > view.byteLength) throw new Error('truncated body');
    bodies.push(body(new DataView(buffer, offset, size)));
    offset += size;
  }
  if (offset !== view.byteLength) throw new Error('extra bytes after the bodies');
  return { id: view.getUint32(4, true), info, bodies };
}

function json(bytes) {
  try {
    return JSON.parse(new TextDecoder('utf-8', { fatal: true }).decode(bytes));
  } catch {
    throw new Error('pose reply without its JSON object');
  }
}

function body(view) {
  const flags = view.getUint16(2, true);
  const joints = view.getUint16(30, true);
  const face = HEAD + 8 * joints;
  const stretch = face + (flags & EXPRESSION ? SHAPES : 0);
  const least = stretch + (flags & TRANSLATIONS ? 2 : 0);
  if (!joints || least > view.byteLength) throw new Error(`truncated body of ${joints} joints`);
  const floats = (at, count) => Float32Array.from({ length: count }, (_, i) => view.getFloat32(at + 4 * i, true));
  const t = view.getFloat64(20, true);
  const place = floats(64, 8);
  const made = {
    key: view.getUint32(4, true),
    you: (flags & YOU) !== 0,
    frameId: view.getUint32(8, true),
    at: view.getFloat64(12, true),
    t: Number.isFinite(t) ? t : null,
    opacity: view.getUint8(28) / 255,
    sha256: Array.from({ length: 32 }, (_, i) => view.getUint8(32 + i).toString(16).padStart(2, '0')).join(''),
    place: { translation: place.slice(0, 3), rotation: place.slice(3, 7), scale: place[7] },
    root: floats(96, 3),
    joints: new Float32Array(4 * joints),
    expression: flags & EXPRESSION ? new Float32Array(SHAPES) : null,
    translations: flags & TRANSLATIONS ? moved(view, stretch, joints) : null,
  };
  for (let i = 0; i < 4 * joints; i++) made.joints[i] = view.getInt16(HEAD + 2 * i, true);
  for (let i = 0; i < 4 * joints; i += 4) {
    if (!unit(made.joints, i)) throw new Error('a body with an invalid rotation');
  }
  if (made.expression) for (let i = 0; i < SHAPES; i++) made.expression[i] = view.getUint8(face + i) / 255;
  const numbers = [made.at, ...place, ...made.root, ...(made.translations ?? [])];
  const turn = Math.hypot(...made.place.rotation);
  if (!numbers.every(near) || !(place[7] >= SMALLEST) || !(turn > 0.9 && turn < 1.1)) {
    throw new Error('a body with an invalid position');
  }
  unit(made.place.rotation, 0);
  return made;
}

/** Return the translations [3 J] of all joints; only a few are stored. */
function moved(view, start, joints) {
  const count = view.getUint16(start, true);
  if (start + 2 + 14 * count > view.byteLength) throw new Error(`truncated body of ${count} moved joints`);
  const out = new Float32Array(3 * joints);
  for (let at = start + 2; at < start + 2 + 14 * count; at += 14) {
    const joint = view.getUint16(at, true);
    if (joint >= joints) throw new Error(`moved joint ${joint} does not exist (${joints} joints)`);
    for (let k = 0; k < 3; k++) out[3 * joint + k] = view.getFloat32(at + 2 + 4 * k, true);
  }
  return out;
}

/** Return whether a number is finite and within the server's limits; the first one is a time, the others metres. */
const near = (value, i) => Number.isFinite(value) && (i === 0 || Math.abs(value) <= 1e6);

/** Normalise the quaternion at `i`; return false if it is too short. */
function unit(q, i) {
  const length = Math.hypot(q[i], q[i + 1], q[i + 2], q[i + 3]);
  if (!(length > 0)) return false;
  for (let k = 0; k < 4; k++) q[i + k] /= length;
  return true;
}

/** Interpolate quaternions x y z w by slerp the shorter way; `part`: 0 gives `first`, 1 `second`. */
function slerp(out, first, second, part) {
  for (let i = 0; i < out.length; i += 4) {
    let dot = 0;
    for (let k = 0; k < 4; k++) dot += first[i + k] * second[i + k];
    const sign = dot < 0 ? -1 : 1;
    const angle = Math.acos(Math.min(1, Math.abs(dot)));
    const sine = Math.sin(angle);
    const a = sine > 1e-4 ? Math.sin((1 - part) * angle) / sine : 1 - part;
    const b = (sine > 1e-4 ? Math.sin(part * angle) / sine : part) * sign;
    for (let k = 0; k < 4; k++) out[i + k] = a * first[i + k] + b * second[i + k];
    unit(out, i);
  }
  return out;
}

const lerp = (out, first, second, part) => {
  for (let i = 0; i < out.length; i++) out[i] = first[i] + (second[i] - first[i]) * part;
  return out;
};

/** Maps one clock to another by their smallest observed difference, which may grow by DRIFT. */
class Clock {
  apart = null; // ms
  #seen = 0;

  /** Return the time on our clock of `theirs`, which was read at `ours` or later. */
  add(theirs, ours) {
    const now = ours - theirs;
    const kept = this.apart === null ? now : this.apart + DRIFT * Math.max(0, ours - this.#seen);
    this.apart = Math.abs(now - kept) > TORN ? now : Math.min(now, kept);
    this.#seen = ours;
    return theirs + this.apart;
  }
}

/**
 * People by their bodies. Others are interpolated between samples; mouths, and the user, are shown at the newest one.
 */
export class People {
  room = null; // the newest `room` of a reply
  #people = new Map(); // by key: {samples: [{time, body}], clock, shown}
  #clock = new Clock(); // the server's on ours

  /** Take a reply of parsePoses that arrived at `now` (ms, performance.now()). */
  arrived({ info, bodies }, now) {
    if (Number.isFinite(info.now)) this.#clock.add(info.now, now);
    if (Array.isArray(info.room?.people)) {
      this.room = info.room;
      const there = new Set(info.room.people.map((one) => one?.key));
      for (const key of this.#people.keys()) if (!there.has(key)) this.#people.delete(key);
    }
    for (const one of bodies) this.#add(one);
  }

  /** Forget everybody, for another connection. */
  clear() {
    this.#people.clear();
    this.#clock = new Clock();
    this.room = null;
  }

  get size() {
    return this.#people.size;
  }

  /** Return an interpolated body per person at `now`, with its `age` in ms. The arrays are reused by the next call. */
  at(now) {
    const server = now - (this.#clock.apart ?? 0);
    return [...this.#people.values()].map((person) => shown(person, server));
  }

  #add(one) {
    const known = this.room ? this.room.people.some((other) => other?.key === one.key) : one.key === 0;
    if (!known) return;
    let person = this.#people.get(one.key);
    if (person?.samples.at(-1).body.joints.length !== one.joints.length) {
      person = { samples: [], clock: new Clock(), shown: null };
      this.#people.set(one.key, person);
    }
    const time = one.t === null ? one.at : person.clock.add(one.t, one.at);
    const last = person.samples.at(-1);
    if (last && time <= last.time) {
      if (one.frameId !== last.body.frameId || one.at !== last.body.at) return; // it is older
      last.body = one; // the same sample with another opacity
    } else {
      person.samples.push({ time, body: one });
      if (person.samples.length > KEPT) person.samples.shift();
    }
  }
}

function shown(person, server) {
  const { samples } = person;
  const last = samples.at(-1);
  const time = last.body.you ? Infinity : server - delay(samples);
  let i = samples.length - 1;
  while (i > 0 && samples[i].time > time) i--;
  const first = samples[i];
  const second = samples[Math.min(i + 1, samples.length - 1)];
  const span = second.time - first.time;
  const part = span > 0 ? Math.min(1, Math.max(0, (time - first.time) / span)) : 0;
  person.shown ??= blank(last.body);
  mix(person.shown, first.body, second.body, part);
  speak(person.shown, last.body);
  const { key, you, frameId, at, t, opacity, sha256 } = last.body;
  const age = Math.max(0, server - first.time - span * part);
  return Object.assign(person.shown, { key, you, frameId, at, t, opacity, sha256, age });
}

/**
 * Return the delay of other people, ms: a little above the longest recent pause, so that there is a sample on either
 * side.
 */
function delay(samples) {
  let longest = 0;
  for (let i = 1; i < samples.length; i++) longest = Math.max(longest, samples[i].time - samples[i - 1].time);
  return Math.min(LATEST, 1.1 * longest);
}

const blank = ({ joints }) => ({
  place: { translation: new Float32Array(3), rotation: new Float32Array(4), scale: 1 },
  root: new Float32Array(3),
  joints: new Float32Array(joints.length),
});

/** Use the newest mouth without the body's delay: its sound is heard without delay, too. */
function speak(out, { expression }) {
  if (!expression && !out.expression) return;
  out.expression ??= new Float32Array(SHAPES);
  for (const i of MOUTH) out.expression[i] = expression?.[i] ?? 0;
}

const CALM = new Float32Array(SHAPES);

function mix(out, a, b, part) {
  slerp(out.joints, a.joints, b.joints, part);
  lerp(out.root, a.root, b.root, part);
  slerp(out.place.rotation, a.place.rotation, b.place.rotation, part);
  lerp(out.place.translation, a.place.translation, b.place.translation, part);
  out.place.scale = a.place.scale + (b.place.scale - a.place.scale) * part;
  const face = a.expression || b.expression;
  out.expression = face ? lerp(out.expression ?? new Float32Array(SHAPES), a.expression ?? CALM, b.expression ?? CALM, part) : null;
  const [from, to] = [a.translations ?? b.translations, b.translations ?? a.translations];
  out.translations = from ? lerp(out.translations ?? new Float32Array(from.length), from, to, part) : null;
}
