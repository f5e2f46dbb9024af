// Restores lost pieces from parity pieces: a Reed-Solomon code over GF(256) with a Cauchy matrix.
//
// Twin: glsplat/extras/far_links/datagrams/erasure.py.

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

/** Fill the undefined `pieces` from `parity`, a Map of row to bytes of `length`, with at least as many entries. */
export function restore(pieces, parity, length) {
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
