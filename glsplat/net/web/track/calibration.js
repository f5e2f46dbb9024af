// Measures the user's eye height, stature, arm span and floor in two seconds of standing still. The server fits the
// avatar to them. Twin: glsplat/tracking/calibration.py.

import { browserStorage, keep, readKept } from '../settings.js';

const DURATION = 2000; // milliseconds of standing still
const KEY = 'glsplat.calibration';
export const EYES_OF_STATURE = 0.936; // eye height / stature (Drillis & Contini 1966)
const LEAST_SAMPLES = 10;
const STILL = 0.05; // metres the eyes may be from their median
const FARTHEST = 1e4; // metres: beyond it a position is a fault of the device
const GRIP_TO_WRIST = 0.09; // metres, as glsplat/tracking/sample.py has it
const SPAN_OF_EYES = 0.874; // arm span wrist to wrist / eye height of the embedded body
const STRETCHED = [0.85, 1.2]; // of that, where the arms count as stretched sideways
const RANGES = { height: [0.5, 2.8], eyes: [0.5, 2.6], span: [0.3, 2.5], floor: [-10, 10] }; // metres, as /ws takes them

/** Measures a user who stands straight and looks ahead. Times are milliseconds of one growing clock. */
export class Calibration {
  #storage;
  #start = null;
  #height = null;
  #eyes = [];
  #spans = [];

  constructor(storage = browserStorage()) {
    this.#storage = storage;
  }

  /** Whether it is measuring. */
  get running() {
    return this.#start !== null;
  }

  /** Begin; `height`: the user's stature in metres if known, which places the floor. */
  begin(nowMs, { height = null } = {}) {
    this.#start = nowMs;
    this.#height = within(height, RANGES.height) ? height : null;
    this.#eyes = [];
    this.#spans = [];
  }

  /** Stop without a result. */
  cancel() {
    this.#start = null;
  }

  /**
   * One sample (the protocol's `tracking`; null: nothing tracked). Returns {progress: 0..1}; at the end
   * {result: {height, eyes, span, floor}} in metres (span null where the arms hung) or {error: text}.
   */
  add(sample, nowMs) {
    if (!this.running) return { error: 'No calibration is running: start one first.' };
    if (usable(sample?.head)) this.#eyes.push(sample.head.slice(0, 3));
    const wrists = ['left', 'right'].map((side) => wrist(sample, side));
    if (wrists.every((place) => place !== null)) this.#spans.push(distance(...wrists));
    const progress = (nowMs - this.#start) / DURATION;
    if (progress < 1) return { progress: Math.max(progress, 0) };
    this.#start = null;
    return this.#measure();
  }

  /** The result kept in this browser, or null. */
  load() {
    const { height, eyes, span, floor } = readKept(this.#storage, KEY);
    const right =
      within(height, RANGES.height) &&
      within(eyes, RANGES.eyes) &&
      (span === null || within(span, RANGES.span)) &&
      within(floor, RANGES.floor);
    return right ? { height, eyes, span, floor } : null;
  }

  /** Keep a result in this browser. Returns whether it was kept. */
  save({ height, eyes, span, floor }) {
    return keep(this.#storage, KEY, { height, eyes, span, floor });
  }

  #measure() {
    const count = this.#eyes.length;
    if (count < LEAST_SAMPLES) {
      return { error: `The headset lost tracking (${count} samples, ${LEAST_SAMPLES} needed): try again.` };
    }
    const middle = [0, 1, 2].map((axis) => median(this.#eyes.map((eye) => eye[axis])));
    const sorted = this.#eyes.map((eye) => [distance(eye, middle), eye[1]]).sort((a, b) => a[0] - b[0]);
    const still = sorted.slice(0, Math.max(LEAST_SAMPLES, Math.floor(count / 2)));
    if (still.at(-1)[0] > STILL) {
      return { error: 'The head moved: stand still for two seconds and look straight ahead.' };
    }
    const level = still.reduce((sum, [, y]) => sum + y, 0) / still.length;
    const floor = this.#height === null ? 0 : level - EYES_OF_STATURE * this.#height;
    const eyes = level - floor;
    if (!within(eyes, RANGES.eyes) || !within(floor, RANGES.floor)) {
      return { error: `The eyes are ${eyes.toFixed(2)} m above the floor, not 0.5 to 2.6: type your height instead.` };
    }
    return { result: { height: this.#height ?? eyes / EYES_OF_STATURE, eyes, span: this.#span(eyes), floor } };
  }

  /** Return the arm span if the arms were stretched sideways, else null. */
  #span(eyes) {
    if (!this.#spans.length) return null;
    const sorted = [...this.#spans].sort((a, b) => a - b);
    const widest = sorted[Math.floor(0.9 * (sorted.length - 1))];
    return within(widest / (SPAN_OF_EYES * eyes), STRETCHED) && within(widest, RANGES.span) ? widest : null;
  }
}

function usable(pose) {
  return Array.isArray(pose) && pose.length === 7 && pose.every((v) => Math.abs(v) < FARTHEST);
}

/** Return a wrist [x, y, z]: tracked, or behind a controller's grip along its y; null if neither is tracked. */
function wrist(sample, side) {
  if (usable(sample?.[side])) return sample[side].slice(0, 3);
  const grip = sample?.[`${side}_grip`];
  if (!usable(grip)) return null;
  const [px, py, pz, x, y, z, w] = grip;
  const k = GRIP_TO_WRIST / (x * x + y * y + z * z + w * w || Infinity);
  return [px + k * 2 * (x * y - w * z), py + k * (w * w - x * x + y * y - z * z), pz + k * 2 * (y * z + w * x)];
}

function within(value, [least, most]) {
  return typeof value === 'number' && value >= least && value <= most;
}

function distance(a, b) {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

function median(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
}
