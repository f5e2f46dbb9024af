// The page's side of twins: a test of Node for each name of vectors.json (tests/twins.py), which lies beside this file.

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { Duplex } from 'node:stream';
import { test } from 'node:test';
import { createInflateRaw } from 'node:zlib';

try {
  new DecompressionStream('deflate-raw');
} catch { // Node 18, which Debian 12 has; browsers have it
  globalThis.DecompressionStream = class {
    constructor() {
      Object.assign(this, Duplex.toWeb(createInflateRaw()));
    }
  };
}

/** The bytes of a vector's base64. */
export const bytesOf = (text) => new Uint8Array(Buffer.from(text, 'base64'));

export const textOf = (bytes) => Buffer.from(bytes).toString('base64');

/** `twins`: by name a function from a vector's input to its answer, or to a promise of it. */
export function check(twins) {
  const vectors = JSON.parse(readFileSync(new URL('vectors.json', import.meta.url)));
  assert.deepEqual(Object.keys(twins).sort(), Object.keys(vectors).sort());
  for (const [name, { tolerance, cases }] of Object.entries(vectors)) {
    test(name, async () => {
      for (const [number, { in: given, out }] of cases.entries()) same(plain(await twins[name](given)), out, tolerance, `${name} ${number}`);
    });
  }
}

const plain = (value) => JSON.parse(JSON.stringify(value, (_, v) => (ArrayBuffer.isView(v) ? [...v] : v)));

function same(found, wanted, tolerance, where) {
  if (typeof wanted === 'number') {
    assert.ok(Math.abs(found - wanted) <= tolerance * Math.max(1, Math.abs(wanted)), `${where}: ${found}, not ${wanted}`);
  } else if (wanted !== null && typeof wanted === 'object') {
    assert.equal(Array.isArray(found), Array.isArray(wanted), where);
    assert.deepEqual(Object.keys(found).sort(), Object.keys(wanted).sort(), where);
    for (const key of Object.keys(wanted)) same(found[key], wanted[key], tolerance, `${where}.${key}`);
  } else {
    assert.equal(found, wanted, where);
  }
}
