// Records tracking as JSON Lines, which `glsplat replay`, `glsplat tracking` and the page itself play.

/** Bytes of one recording that the page keeps. With both hands about an hour at 120 Hz. */
const MAX_BYTES = 2 ** 30;

const PART = 1 << 20; // characters kept as text before they become a Blob, which the browser may put on disk
const POSES = ['head', 'left', 'right'];
const GRIPS = ['left_grip', 'right_grip'];
const HANDS = ['left_joints', 'right_joints', 'left_curl', 'right_curl'];

/** Collects samples (the protocol's `tracking`) between start() and stop(). */
export class Recorder {
  #limit;
  #parts = [];
  #lines = [];
  #pending = 0;
  #bytes = 0;
  #first = null;
  #last = null;

  /** How many samples are in it. */
  count = 0;
  /** Whether add() takes samples. */
  recording = false;
  /** Why it stopped by itself, in words; else ''. */
  word = '';

  constructor(limit = MAX_BYTES) {
    this.#limit = limit;
  }

  /** Seconds from the first to the last sample. */
  get seconds() {
    return this.count ? (this.#last - this.#first) / 1000 : 0;
  }

  /** Begin anew; what was recorded before is gone. */
  start() {
    this.#clear();
    this.count = 0;
    this.word = '';
    this.recording = true;
  }

  /**
   * Take a sample of time `tMs` (milliseconds, any origin, growing); `extra` are further keys of its line, such as
   * {body: ...}. Returns whether it was taken: not when stopped or full, and not twice for one time.
   */
  add(sample, tMs, extra = {}) {
    if (!this.recording || !Number.isFinite(tMs) || (this.#last !== null && tMs <= this.#last)) return false;
    const line = `${JSON.stringify(lineOf(sample, (tMs - (this.#first ?? tMs)) / 1000, extra))}\n`;
    if (this.#bytes + line.length > this.#limit) {
      this.recording = false;
      this.word = `Recording stopped: it is full (${this.count} samples, ${Math.round(this.seconds)} s).`;
      return false;
    }
    this.#first ??= tMs;
    this.#last = tMs;
    this.#lines.push(line);
    this.#pending += line.length;
    this.#bytes += line.length;
    this.count += 1;
    if (this.#pending >= PART) this.#flush();
    return true;
  }

  /** End and hand over: a Blob of JSON Lines. `count` and `seconds` stay until the next start(). */
  stop() {
    this.recording = false;
    this.#flush();
    const blob = new Blob(this.#parts, { type: 'application/jsonl' });
    this.#parts = [];
    return blob;
  }

  #flush() {
    if (this.#lines.length) this.#parts.push(new Blob(this.#lines));
    this.#lines = [];
    this.#pending = 0;
  }

  #clear() {
    this.#parts = [];
    this.#lines = [];
    this.#pending = 0;
    this.#bytes = 0;
    this.#first = null;
    this.#last = null;
  }
}

/** One line's object: t in seconds, the poses (null: not tracked), then what is known beside them. */
function lineOf(sample, t, extra) {
  const line = { t: rounded(t) };
  for (const key of POSES) line[key] = known(sample[key]);
  for (const key of [...GRIPS, ...HANDS]) {
    const value = known(sample[key]);
    if (value !== null) line[key] = value;
  }
  if (sample.expression) line.expression = rounded(sample.expression);
  for (const [key, value] of Object.entries(extra)) {
    if (!(key in line)) line[key] = rounded(value);
  }
  return line;
}

/** A value of the sample rounded, or null where a number in it is not finite: a reader refuses a pose with holes. */
function known(value) {
  return value === undefined || value === null || !finite(value) ? null : rounded(value);
}

function finite(value) {
  return typeof value === 'number' ? Number.isFinite(value) : Array.from(value).every(finite);
}

/** Numbers to six decimals (micrometres), typed arrays as lists. */
function rounded(value) {
  if (typeof value === 'number') return Number.isFinite(value) ? Math.round(value * 1e6) / 1e6 : null;
  if (value === null || typeof value !== 'object') return value;
  if (Array.isArray(value) || ArrayBuffer.isView(value)) return Array.from(value, rounded);
  return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, rounded(item)]));
}
