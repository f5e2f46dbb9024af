// What moves the avatar when nobody wears a headset: nothing, a motion of the server's, or a recording.
// at(seconds) -> fields for a request: {pose} or {tracking, t}. Seconds are those of one clock that grows; t is the
// same clock in milliseconds, so that a recording goes on in time when it begins anew.

import { BODY_JOINTS } from './xr-sample.js';

/** The most that a recording may hold here, bytes. */
const MAX_BYTES = 64 * 2 ** 20;
const MAX_LINE = 2 ** 20; // characters
const USUAL_STEP = 1 / 72; // seconds a sample lasts where a recording has only one

const POSES = ['head', 'left', 'right', 'left_grip', 'right_grip'];
const TRACKERS = ['waist', 'left_foot', 'right_foot'];
const HANDS = ['left_joints', 'right_joints'];
const NUMBERS = ['left_curl', 'right_curl'];
const FLAT_JOINTS = new Map([[75, 3], [175, 7], [78, 3], [182, 7]]);
const MOST_JOINTS = 256; // entries of a body
const MOST_SHAPES = 256; // names of an expression
const GAZES = ['leftEye', 'rightEye'];
const FARTHEST = 1e4; // metres; the server refuses what is farther
const QUATERNION = [1e-9, 1e3]; // lengths that the server takes

/** The rest pose, or what the scene says: a request without a pose. */
export class Rest {
  duration = 0;
  frames = 1;

  at() {
    return {};
  }
}

/** A motion of /motions/NAME ({fps, frames: [pose, ...]}) in a loop. Twin: glsplat/motion/motion.py. */
export class Motion {
  #fps;
  #keys;

  constructor({ fps, frames }) {
    if (!Array.isArray(frames) || !frames.length || !(fps > 0 && fps < Infinity)) {
      throw new Error('A motion needs a frame rate above zero and at least one frame.');
    }
    this.#fps = fps;
    this.frames = frames.length;
    this.duration = frames.length / fps;
    const names = [...new Set(frames.flatMap(Object.keys))];
    this.#keys = names.map((name) => track(name, frames));
  }

  /** {pose} at a time in seconds: rotations by slerp, the translation linearly. */
  at(seconds) {
    const place = wrapped(seconds * this.#fps, this.frames);
    const first = Math.min(Math.floor(place), this.frames - 1);
    const second = (first + 1) % this.frames;
    const between = place - first;
    return { pose: Object.fromEntries(this.#keys.map(({ name, at }) => [name, at(first, second, between)])) };
  }
}

/** Samples as parseRecording() gives them, in a loop. Between two samples the earlier one holds. */
export class Recording {
  #times = []; // seconds from the first sample, growing
  #tracking = [];

  constructor(samples) {
    const start = samples[0]?.t;
    if (start === undefined) throw new Error('A recording needs at least one sample with a time.');
    for (const { t, ...tracking } of samples) {
      if (this.#times.length && t - start <= this.#times.at(-1)) continue; // nothing new
      this.#times.push(t - start);
      this.#tracking.push(tracking);
    }
    const steps = this.#times.slice(1).map((time, i) => time - this.#times[i]);
    const step = steps.length ? steps.sort((a, b) => a - b)[steps.length >> 1] : USUAL_STEP;
    this.frames = this.#times.length;
    this.duration = this.#times.at(-1) + step;
  }

  /** {tracking, t} at a time in seconds: t is the sample's own time on that clock, in milliseconds. */
  at(seconds) {
    const time = wrapped(seconds, this.duration);
    const round = Math.round((seconds - time) / this.duration);
    let [first, after] = [0, this.frames];
    while (after - first > 1) {
      const middle = (first + after) >> 1;
      if (this.#times[middle] <= time) first = middle;
      else after = middle;
    }
    return { tracking: this.#tracking[first], t: 1000 * (round * this.duration + this.#times[first]) };
  }
}

/** The samples of a file (a Blob) of JSON Lines. Rejects with one clear line. */
export async function readRecording(file) {
  checkSize(file.size);
  return parseRecording(await file.text());
}

/**
 * The samples of a recording's text, [{t in seconds, head, left, ...}]: what glsplat.tracking.recording writes.
 * A device whose numbers are not finite is not tracked. Throws Error, one line that names the text's line.
 */
export function parseRecording(text) {
  checkSize(text.length);
  const samples = [];
  for (let start = 0, number = 1; start < text.length; number++) {
    const newline = text.indexOf('\n', start);
    const end = newline < 0 ? text.length : newline;
    try {
      const line = lineOf(text, start, end);
      const sample = line && sampleOf(objectOf(line));
      if (sample && Number.isFinite(sample.t)) samples.push(sample);
    } catch (error) {
      throw new Error(`Line ${number} of the recording: ${error.message}`, { cause: error });
    }
    start = end + 1;
  }
  if (!samples.length) throw new Error('The recording has no sample with a time.');
  return samples;
}

function checkSize(size) {
  if (size <= MAX_BYTES) return;
  const [most, found] = [MAX_BYTES, size].map((bytes) => Math.ceil(bytes / 2 ** 20));
  throw new Error(`A recording may have ${most} MiB here, not ${found}; glsplat replay plays longer ones.`);
}

function lineOf(text, start, end) {
  if (end - start > MAX_LINE) throw new Error('a line has at most 1 MiB.');
  return text.slice(start, end).replace(/^\uFEFF/, '').trim();
}

/** JSON, and the NaN and Infinity that Python writes and reads: they become infinite. */
function objectOf(line) {
  try {
    return JSON.parse(line);
  } catch (error) {
    const finite = line.replace(/"(?:[^"\\]|\\.)*"|-?\b(?:NaN|Infinity)\b/g, (m) => (m[0] === '"' ? m : '1e999'));
    try {
      return JSON.parse(finite);
    } catch {
      throw new Error(`expected one JSON object (${error.message}).`);
    }
  }
}

/** A line's object as the wire has it. */
function sampleOf(data) {
  if (data === null || typeof data !== 'object' || Array.isArray(data)) {
    throw new Error('expected an object {"t": seconds, "head": [7 numbers], ...}.');
  }
  if (data.t === undefined || data.t === null) throw new Error('a sample needs its time, "t" in seconds.');
  if (!POSES.some((key) => key in data)) throw new Error('a sample needs "head" or a hand.');
  const sample = { t: numberOf(data.t, 't') };
  for (const key of [...POSES, ...TRACKERS]) if (key in data) sample[key] = poseOf(data[key], key);
  for (const key of HANDS) if (key in data) sample[key] = jointsOf(data[key], key);
  for (const key of NUMBERS) {
    if (key in data) sample[key] = data[key] === null ? null : finiteOr(numberOf(data[key], key));
  }
  if (data.body !== undefined && data.body !== null) sample.body = bodyOf(data.body);
  for (const key of GAZES) {
    const gaze = data[key] === undefined || data[key] === null ? [0] : numbersOf(data[key], key, [3]);
    if (Math.hypot(...gaze) > 1e-6 && Math.hypot(...gaze) < 1e6) sample[key] = gaze; // NaN fails this
  }
  if (data.expression !== undefined && data.expression !== null) sample.expression = expressionOf(data.expression);
  return sample;
}

/** Weights by name, or 52 in ARKit's order, which are finite. */
function expressionOf(value) {
  if (Array.isArray(value)) return numbersOf(value, 'expression', [52]).map((weight) => finiteOr(weight) ?? 0);
  if (typeof value !== 'object') throw new Error(`"expression" is an object of weights by name, not ${kind(value)}.`);
  const count = Object.keys(value).length;
  if (count > MOST_SHAPES) throw new Error(`"expression" needs at most ${MOST_SHAPES} names, not ${count}.`);
  const weights = Object.entries(value).filter(([, weight]) => weight !== null);
  return Object.fromEntries(weights.map(([name, weight]) => [name, finiteOr(numberOf(weight, `expression.${name}`)) ?? 0]));
}

/** The places of the joints that are used. */
function bodyOf(body) {
  if (typeof body !== 'object' || Array.isArray(body)) {
    throw new Error(`"body" is an object of joints by name, not ${kind(body)}.`);
  }
  const count = Object.keys(body).length;
  if (count > MOST_JOINTS) throw new Error(`"body" needs at most ${MOST_JOINTS} joints, not ${count}.`);
  const used = BODY_JOINTS.filter((name) => body[name] !== undefined && body[name] !== null);
  const places = used.map((name) => [name, numbersOf(body[name], `body.${name}`, [3, 7]).slice(0, 3)]);
  return Object.fromEntries(places.filter(([, place]) => place.every((v) => Math.abs(v) <= FARTHEST)));
}

function numberOf(value, key) {
  if (typeof value !== 'number') throw new Error(`"${key}" is a number, not ${kind(value)}.`);
  return value;
}

function finiteOr(value) {
  return Number.isFinite(value) ? value : null;
}

function numbersOf(value, key, counts) {
  if (!Array.isArray(value) || !counts.includes(value.length)) {
    const found = Array.isArray(value) ? value.length : kind(value);
    throw new Error(`"${key}" needs ${counts.join(' or ')} numbers, found ${found}.`);
  }
  const bad = value.find((v) => typeof v !== 'number');
  if (bad !== undefined) throw new Error(`"${key}" needs numbers, found ${kind(bad)}.`);
  return value;
}

function poseOf(value, key) {
  if (value === null) return null;
  const pose = numbersOf(value, key, [7]);
  const turn = Math.hypot(...pose.slice(3));
  const usable = pose.slice(0, 3).every((v) => Math.abs(v) <= FARTHEST) && turn > QUATERNION[0] && turn < QUATERNION[1];
  return usable ? pose : null;
}

function jointsOf(value, key) {
  if (value === null) return null;
  if (!Array.isArray(value)) throw new Error(`"${key}" is a list of 25 joints, not ${kind(value)}.`);
  let joints = value;
  if (typeof value[0] === 'number') {
    const size = FLAT_JOINTS.get(value.length);
    if (!size) throw new Error(`"${key}" needs 25 joints of 3 or 7 numbers, found ${value.length} numbers.`);
    joints = Array.from({ length: value.length / size }, (_, i) => value.slice(i * size, (i + 1) * size));
  }
  if (joints.length !== 25 && joints.length !== 26) {
    throw new Error(`"${key}" needs 25 joints, found ${joints.length}.`);
  }
  joints = joints.slice(-25).map((joint) => numbersOf(joint, key, [3, 7])); // OpenXR's 26 begin with the palm
  return joints.flat().every((v) => Number.isFinite(v)) ? joints : null;
}

function kind(value) {
  if (value === null) return 'null';
  return Array.isArray(value) ? 'a list' : `a ${typeof value}`;
}

/** value modulo period, 0 <= result < period, also for negative values. */
function wrapped(value, period) {
  const rest = value % period;
  if (rest >= 0) return rest;
  return rest + period < period ? rest + period : 0;
}

/** One key of the poses: {name, at(first, second, between) -> list}. Frames that lack it have zeros there. */
function track(name, frames) {
  const size = Math.max(...frames.map((frame) => [frame[name] ?? []].flat(2).length));
  const rows = frames.map((frame) => {
    const row = [frame[name] ?? []].flat(2);
    return row.length ? row : new Array(size).fill(0);
  });
  if (size % 3 || rows.some((row) => row.length !== size || !row.every(Number.isFinite))) {
    throw new Error(`The motion's "${name}" needs three finite numbers a joint, alike in every frame.`);
  }
  if (!name.endsWith('_pose')) {
    return { name, at: (a, b, k) => rows[a].map((v, i) => v + k * (rows[b][i] - v)) };
  }
  const turns = rows.map((row) => Array.from({ length: size / 3 }, (_, i) => quaternion(row.slice(3 * i, 3 * i + 3))));
  const at = (a, b, k) => turns[a].map((turn, i) => rotationVector(slerp(turn, turns[b][i], k)));
  return { name, at };
}

/** The unit quaternion [x, y, z, w] of a rotation vector (radians). */
export function quaternion([x, y, z]) {
  const angle = Math.hypot(x, y, z);
  const k = angle > 1e-9 ? Math.sin(angle / 2) / angle : 0.5;
  return [k * x, k * y, k * z, Math.cos(angle / 2)];
}

/** The rotation vector of a unit quaternion, at most pi long. */
export function rotationVector([x, y, z, w]) {
  const sine = Math.hypot(x, y, z);
  const k = sine > 1e-9 ? (2 * Math.atan2(sine, Math.abs(w))) / sine : 2;
  const sign = w < 0 ? -k : k;
  return [sign * x, sign * y, sign * z];
}

/** Between two unit quaternions by the short way; k 0..1. */
function slerp(a, b, k) {
  const cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
  const sign = cosine < 0 ? -1 : 1;
  const angle = Math.acos(Math.min(Math.abs(cosine), 1));
  const sine = Math.sin(angle);
  const [ka, kb] = sine > 1e-6 ? [Math.sin((1 - k) * angle) / sine, Math.sin(k * angle) / sine] : [1 - k, k];
  return a.map((v, i) => ka * v + sign * kb * b[i]);
}

const [LEFT_HIP, RIGHT_HIP, SPINE1, LEFT_ANKLE, RIGHT_ANKLE, SPINE3, NECK, HEAD] = [0, 1, 2, 6, 7, 8, 11, 14]; // of body_pose
const LEGS = 0.9; // metres from the hips to the floor: feet stay where they are while the hips move
const LOOKS = [0, 0.34, 0.1, -0.3, 0, -0.14, 0.26, 0]; // radians to the left, one after the other
const NODS = [0, 0.05, -0.04, 0.06, 0, 0.1, -0.03, 0.02];
const STAY = 3.7; // seconds for each
const TURNING = 0.9; // seconds from one to the next

/**
 * A driver around another one whose poses have a `body_pose`. Who only waits is alive: on top of a motion that stands,
 * slow turns of the head, a shift of weight, and breath, which do not come round together.
 */
export class Living {
  #motion;

  constructor(motion) {
    this.#motion = motion;
    [this.duration, this.frames] = [motion.duration, motion.frames];
  }

  /** {pose} at a time in seconds. */
  at(seconds) {
    const drive = this.#motion.at(seconds);
    const { body_pose: body, trans } = drive.pose ?? {};
    if (!body || body.length < HEAD + 1 || !trans) return drive;
    const turns = body.map((turn) => [...turn]);
    const add = (joint, axis, angle) => (turns[joint][axis] += angle);
    const shift = 0.022 * Math.sin(seconds * 0.37) + 0.012 * Math.sin(seconds * 0.23 + 1); // metres to the left
    const lean = Math.atan2(shift, LEGS);
    for (const hip of [LEFT_HIP, RIGHT_HIP]) add(hip, 2, -lean);
    for (const ankle of [LEFT_ANKLE, RIGHT_ANKLE]) add(ankle, 2, lean);
    add(SPINE1, 2, 0.6 * lean);
    add(SPINE3, 0, 0.014 * Math.sin(seconds * 1.45)); // breath
    const look = eased(LOOKS, seconds);
    add(SPINE3, 1, 0.15 * look);
    add(NECK, 1, 0.35 * look);
    add(HEAD, 1, 0.5 * look);
    add(HEAD, 0, eased(NODS, seconds));
    return { ...drive, pose: { ...drive.pose, body_pose: turns, trans: [trans[0] + shift, trans[1], trans[2]] } };
  }
}

/** From one value to the next, each of which stays for a while. */
function eased(values, seconds) {
  const place = seconds / STAY;
  const at = (i) => values[((i % values.length) + values.length) % values.length];
  const t = Math.min(1, ((place - Math.floor(place)) * STAY) / TURNING);
  const part = t * t * (3 - 2 * t);
  return at(Math.floor(place)) + part * (at(Math.floor(place) + 1) - at(Math.floor(place)));
}
