import { createHash } from 'node:crypto';
import { inflateSync } from 'node:zlib';
import { bytesOf, check, textOf } from './twins.js';
import { Assembler, piecesOf } from './stream/pieces.js';

check({
  pictures({ datagrams }) {
    const data = new Uint8Array(inflateSync(bytesOf(datagrams)));
    const [whole, out] = [new Assembler(), []];
    for (let at = 0; at < data.length; ) {
      const size = 2 + data[at] + 256 * data[at + 1];
      const found = whole.add(data.subarray(at + 2, at + size));
      if (found) out.push([found.length, createHash('sha256').update(found).digest('hex')]);
      at += size;
    }
    return out;
  },
  request: ({ number, text }) => piecesOf(number, text).map(textOf),
});
