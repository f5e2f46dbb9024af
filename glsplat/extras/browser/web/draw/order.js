// The order of all splats in view, far to near: depths without reading anything back from the GPU, then an exact sort.
// The camera's row goes into the bones once (four numbers a joint); a depth is then a dot product an influence.

const [BITS, DIGITS] = [11, 1 << 11]; // three digits of a 32-bit key

export class Order {
  #z = new Float32Array(0);
  #bits = new Uint32Array(0);
  #keys = [new Uint32Array(0), new Uint32Array(0)];
  #orders = [new Uint32Array(0), new Uint32Array(0)];
  #numbers = new Uint32Array(0);
  #counts = new Uint32Array(3 * DIGITS);

  /**
   * Indices in the arena, far to near; of equal depths the lower index is drawn last. `items`: [{first, splats, means (of
   * the moment), bones (placed; null: of no skeleton), place, size}], in the arena's order; `row`: frame.js, sortRow. The array is
   * used again by the next call.
   */
  sort(items, row) {
    const count = items.reduce((sum, { splats }) => sum + splats.count, 0);
    this.#grow(count);
    let at = 0;
    for (const item of items) {
      for (let i = 0; i < item.splats.count; i++) this.#numbers[at + i] = item.first + i;
      const z = this.#z.subarray(at, at + item.splats.count);
      if (item.bones) skinned(item, row, z);
      else still(item, row, z);
      at += item.splats.count;
    }
    return this.#sorted(count);
  }

  #grow(count) {
    if (this.#z.length >= count) return;
    const size = Math.ceil(count * 1.25);
    this.#z = new Float32Array(size);
    this.#bits = new Uint32Array(this.#z.buffer);
    this.#keys = [new Uint32Array(size), new Uint32Array(size)];
    this.#orders = [new Uint32Array(size), new Uint32Array(size)];
    this.#numbers = new Uint32Array(size);
  }

  #sorted(count) {
    const [bits, counts, [k0, k1], [o0, o1]] = [this.#bits, this.#counts, this.#keys, this.#orders];
    counts.fill(0);
    for (let i = 0; i < count; i++) {
      const b = bits[i]; // IEEE floats compare like integers once the sign is undone; falling
      const k = b & 0x80000000 ? b : ~(b | 0x80000000) >>> 0;
      k0[i] = k;
      counts[k & (DIGITS - 1)]++;
      counts[DIGITS + ((k >>> BITS) & (DIGITS - 1))]++;
      counts[2 * DIGITS + (k >>> (2 * BITS))]++;
    }
    for (let digit = 0; digit < 3; digit++) {
      let sum = 0;
      for (let i = digit * DIGITS; i < (digit + 1) * DIGITS; i++) {
        const own = counts[i];
        counts[i] = sum;
        sum += own;
      }
    }
    for (let i = count - 1; i >= 0; i--) { // from the last: of equal depths the lower index comes later
      const [k, to] = [k0[i], counts[k0[i] & (DIGITS - 1)]++];
      o0[to] = i;
      k1[to] = k;
    }
    for (let i = 0; i < count; i++) {
      const k = k1[i];
      const to = counts[DIGITS + ((k >>> BITS) & (DIGITS - 1))]++;
      o1[to] = o0[i];
      k0[to] = k;
    }
    const numbers = this.#numbers;
    for (let i = 0; i < count; i++) o0[counts[2 * DIGITS + (k0[i] >>> (2 * BITS))]++] = numbers[o1[i]];
    return o0.subarray(0, count);
  }
}

/** z of splats that follow bones, into `z`. */
function skinned({ splats, means, bones, size }, [x, y, w, t], z) {
  const { joints, weights, influences, count } = splats;
  const rows = new Float64Array(bones.length / 3);
  for (let j = 0, b = 0; b < bones.length; j += 4, b += 12) {
    for (let c = 0; c < 4; c++) rows[j + c] = size * (x * bones[b + c] + y * bones[b + 4 + c] + w * bones[b + 8 + c]);
  }
  for (let i = 0, a = 0, k = 0; i < count; i++, a += 3) {
    let sum = t;
    for (const end = k + influences; k < end; k++) {
      const weight = weights[k];
      if (weight === 0) continue;
      const j = 4 * joints[k];
      sum += weight * (rows[j] * means[a] + rows[j + 1] * means[a + 1] + rows[j + 2] * means[a + 2] + rows[j + 3]);
    }
    z[i] = sum;
  }
}

/** z of splats that stand still, moved as a whole by `place`: 12 numbers, without the size. */
function still({ splats: { count }, means, place, size }, row, z) {
  const c = [0, 1, 2, 3].map((i) => size * (row[0] * place[i] + row[1] * place[4 + i] + row[2] * place[8 + i]));
  for (let i = 0, a = 0; i < count; i++, a += 3) {
    z[i] = c[0] * means[a] + c[1] * means[a + 1] + c[2] * means[a + 2] + c[3] + row[3];
  }
}
