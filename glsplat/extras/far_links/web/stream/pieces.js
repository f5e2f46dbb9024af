// Datagrams to a picture, and a request to datagrams (docs/protocol.md, section 5.3).
// Twin: glsplat/extras/far_links/datagrams/packets.py.

export const HEAD = 12; // bytes before each piece
export const NONCE = 8; // bytes before a picture, sent back to acknowledge it
export const PICTURE = 0;
export const PING = 1;
const REQUEST = 2;
const PIECE = 1124;
const GROUP = 160; // pieces of a group at most
const LARGEST = 8 * 2 ** 20;
const UNFINISHED = 8; // incomplete pictures kept at most

/** Assembles pictures: each once, and none older than the newest complete one. */
export class Assembler {
  newest = -1;
  #unfinished = new Map();

  /** Return the bytes of a picture if this datagram (a Uint8Array of kind PICTURE) completes it, else null. */
  add(datagram) {
    if (datagram.length <= HEAD) return null;
    const view = new DataView(datagram.buffer, datagram.byteOffset, HEAD);
    const [parity, number] = [view.getUint8(1), view.getUint16(2, true)];
    const [id, bytes] = [view.getUint32(4, true), view.getUint32(8, true)];
    if (id <= this.newest || !bytes || bytes > LARGEST || parity > 255 - GROUP) return null;
    let one = this.#unfinished.get(id);
    if (!one) {
      this.#unfinished.set(id, (one = new Unfinished(bytes, parity)));
      if (this.#unfinished.size > UNFINISHED) this.#unfinished.delete(Math.min(...this.#unfinished.keys()));
    }
    if (one.bytes !== bytes || one.parity !== parity || !one.add(number, datagram.subarray(HEAD))) return null;
    this.newest = id;
    for (const old of [...this.#unfinished.keys()]) if (old <= id) this.#unfinished.delete(old);
    return one.whole();
  }
}

class Unfinished {
  #pieces = []; // by group, in order
  #parity = []; // by group: Map from row to piece
  #lacking = [];

  constructor(bytes, parity) {
    Object.assign(this, { bytes, parity, count: Math.ceil(bytes / PIECE) });
    this.groups = Math.ceil(this.count / GROUP);
    for (let group = 0; group < this.groups; group++) {
      const size = Math.ceil((this.count - group) / this.groups);
      this.#pieces.push(new Array(size).fill(undefined));
      this.#parity.push(new Map());
      this.#lacking.push(size);
    }
  }

  /** Keep a piece; return whether the picture is complete. */
  add(number, piece) {
    const own = number < this.count;
    const length = own ? Math.min(PIECE, this.bytes - number * PIECE) : PIECE;
    const at = own ? number : number - this.count;
    const [group, row] = [at % this.groups, Math.floor(at / this.groups)];
    if ((!own && row >= this.parity) || piece.length !== length) return false;
    if (own ? this.#pieces[group][row] : this.#parity[group].has(row)) return false;
    if (own) this.#pieces[group][row] = piece;
    else this.#parity[group].set(row, piece);
    this.#lacking[group]--;
    return this.#lacking.every((lacking) => lacking <= 0);
  }

  whole() {
    const out = new Uint8Array(this.bytes);
    this.#pieces.forEach((pieces, group) => {
      restore(pieces, this.#parity[group], PIECE);
      pieces.forEach((piece, i) => {
        const at = (i * this.groups + group) * PIECE;
        out.set(piece.subarray(0, Math.min(PIECE, this.bytes - at)), at);
      });
    });
    return out;
  }
}

/** Return the datagrams of a request; `number` grows from message to message. */
export function piecesOf(number, text) {
  const bytes = new TextEncoder().encode(text);
  const out = [];
  for (let at = 0, index = 0; at < bytes.length; at += PIECE, index++) {
    const piece = bytes.subarray(at, at + PIECE);
    const datagram = new Uint8Array(HEAD + piece.length);
    const view = new DataView(datagram.buffer);
    view.setUint8(0, REQUEST);
    view.setUint16(2, index, true);
    view.setUint32(4, number, true);
    view.setUint32(8, bytes.length, true);
    datagram.set(piece, HEAD);
    out.push(datagram);
  }
  return out;
}

const POLYNOMIAL = 0x11d; // x^8 + x^4 + x^3 + x^2 + 1
const POWER = new Uint8Array(510);
const LOG = new Uint8Array(256);
for (let exponent = 0, value = 1; exponent < 255; exponent++) {
  POWER[exponent] = POWER[exponent + 255] = value;
  LOG[value] = exponent;
  value = (value << 1) ^ (value & 0x80 ? POLYNOMIAL : 0);
}

const inverse = (a) => POWER[255 - LOG[a]];
/** Return the factor of piece `column` in parity piece `row`. */
const factor = (row, column) => inverse((255 - row) ^ column);

/** Add `by` x `from` to `to`, byte by byte; bytes beyond the end of `from` are zero. */
function add(to, from, by) {
  if (!by) return;
  const log = LOG[by];
  for (let i = 0; i < from.length; i++) if (from[i]) to[i] ^= POWER[log + LOG[from[i]]];
}

function scale(bytes, by) {
  const log = LOG[by];
  for (let i = 0; i < bytes.length; i++) if (bytes[i]) bytes[i] = POWER[log + LOG[bytes[i]]];
}

/**
 * Fill the undefined `pieces` by a Reed-Solomon code over GF(256) with a Cauchy matrix (twin: datagrams/erasure.py)
 * from `parity`, a Map of row to bytes of `length`, with at least as many entries.
 */
function restore(pieces, parity, length) {
  const missing = [];
  for (let i = 0; i < pieces.length; i++) if (!pieces[i]) missing.push(i);
  const rows = [...parity.keys()].slice(0, missing.length);
  const right = rows.map((row) => {
    const sum = new Uint8Array(length);
    sum.set(parity.get(row));
    pieces.forEach((piece, column) => piece && add(sum, piece, factor(row, column)));
    return sum;
  });
  const left = rows.map((row) => Uint8Array.from(missing, (column) => factor(row, column)));
  for (let i = 0; i < missing.length; i++) { // Gauss-Jordan; a pivot is never zero in a Cauchy matrix
    const by = inverse(left[i][i]);
    scale(left[i], by);
    scale(right[i], by);
    for (let j = 0; j < missing.length; j++) {
      const other = left[j][i];
      if (j === i || !other) continue;
      add(left[j], left[i], other);
      add(right[j], right[i], other);
    }
    pieces[missing[i]] = right[i];
  }
}
