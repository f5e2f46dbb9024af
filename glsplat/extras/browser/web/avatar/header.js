// Validates the header of an avatar's file (docs/protocol.md, section 8.1).

/** Limits of a file. */
const MOST = { joints: 4096, splats: 1 << 21, entries: 1 << 24, parts: 64, shapes: 256, name: 64, bytes: 256 << 20 };

const FAR = 1e6; // largest number: metres, sizes or colours
const ABSENT = { splats: 0, entries: 0, density: null, sh: [], shaded: false };
const LOGS = 60; // natural logarithms of sizes

/** An invalid avatar's file; the message is one sentence. */
export class BlobError extends Error {
  name = 'BlobError';
}

export function fail(words) {
  throw new BlobError(words);
}

/** Return the header with the defaults of its parts filled in. Throws BlobError unless it is valid. */
export function checkHeader(header) {
  const whole = (value, least, most) => Number.isInteger(value) && value >= least && value <= most;
  const numbers = (value, size, most = FAR) =>
    Array.isArray(value) && value.length === size && value.every((v) => typeof v === 'number' && Math.abs(v) <= most);
  const text = (value) => typeof value === 'string' && value.length <= MOST.name;
  const check = (right, words) => right || fail(`the header of this avatar has ${words}`);

  check(isObject(header), 'no object');
  check(whole(header.sh_degree, 0, 3), 'an sh_degree that is not 0 to 3');
  check([1, 2, 4, 8].includes(header.influences), 'influences that are not 1, 2, 4 or 8');
  check(typeof header.antialias === 'boolean', 'an antialias that is not true or false');
  const { joints, shapes, parts } = header;
  const count = joints?.parents?.length;
  check(isObject(joints) && whole(count, 1, MOST.joints) && Array.isArray(joints.parents), `no joints, or more than ${MOST.joints}`);
  check(Array.isArray(joints.names) && joints.names.length === count && joints.names.every(text), 'joints without names');
  check(joints.parents.every((parent) => whole(parent, -1, count - 1)), 'a joint with an unknown parent');
  check(numbers(joints.rest, 12 * count) && numbers(joints.inverse_bind, 12 * count), 'joints without 12 finite numbers each');
  if (shapes !== null) {
    const size = shapes?.names?.length;
    check(isObject(shapes) && whole(size, 1, MOST.shapes), `no shapes, or more than ${MOST.shapes}`);
    check(Array.isArray(shapes.names) && shapes.names.every(text), 'shapes without names');
    check(numbers(shapes.sizes, size) && numbers(shapes.limits, 2 * size), 'shapes without sizes and limits');
    const holds = shapes.names.every((_, k) => shapes.limits[2 * k] <= 0 && shapes.limits[2 * k + 1] >= 0);
    check(holds, 'limits of a shape that do not include 0');
  }
  check(Array.isArray(parts) && whole(parts.length, 1, MOST.parts), `no parts, or more than ${MOST.parts}`);
  let end = 0; // end of the last part, bytes after the header
  const levels = new Map();
  for (const part of parts) {
    check(isObject(part) && whole(part.level, 0, MOST.parts), 'a part without a level');
    for (const [name, value] of Object.entries(ABSENT)) part[name] ??= value;
    check(part.offset === end && whole(part.bytes, 1, MOST.bytes), 'a part that does not follow the previous one');
    end += part.bytes;
    check(end <= MOST.bytes, `more than ${MOST.bytes >> 20} MiB of parts`);
    if (part.kind === 'splats') {
      check(whole(part.splats, 1, MOST.splats), `a part without splats, or with more than ${MOST.splats}`);
      check(!levels.has(part.level), 'two parts of one level');
      check(numbers(part.low, 3) && numbers(part.high, 3), 'splats without a box');
      check(numbers(part.scales, 2, LOGS) && numbers(part.colours, 6), 'splats without scales and colours');
      check(numbers(part.sh, header.sh_degree), 'splats without a scale of each SH degree');
      check(part.level === 0 || (typeof part.density === 'number' && part.density >= 0), 'a level without its density');
      levels.set(part.level, part.splats);
    } else if (part.kind === 'surface') {
      check(levels.has(part.level), 'a surface without splats');
      check(typeof part.shaded === 'boolean', 'a shaded that is not true or false');
    } else {
      check(part.kind === 'shapes' && shapes !== null && levels.has(part.level), 'a part that is neither splats nor their shapes nor their surface');
      check(whole(part.entries, 0, MOST.entries), 'too many entries of shapes');
    }
  }
  check(levels.has(0), 'no finest level');
  return header;
}

function isObject(value) {
  return value !== null && typeof value === 'object' && !Array.isArray(value);
}
