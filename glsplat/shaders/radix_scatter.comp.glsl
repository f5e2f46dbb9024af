// Moves every element to its place: the start of its digit and block, plus its rank there.
layout(local_size_x = 64) in;
#include "radix.glsl"

shared uint ranks[16][64];  // digit, thread

void main() {
    uint t = gl_LocalInvocationID.x, block = gl_WorkGroupID.x;
    for (uint d = 0u; d < 16u; ++d) ranks[d][t] = 0u;
    for (uint k = 0u; k < RUN; ++k) {
        uint i = block * BLOCK + t * RUN + k;
        if (i < count) ranks[digit_of(load_key(i))][t] += 1u;
    }
    barrier();
    if (t < 16u) {
        uint before = histogram[t * groups + block];
        for (uint other = 0u; other < THREADS; ++other) {
            uint value = ranks[t][other];
            ranks[t][other] = before;
            before += value;
        }
    }
    barrier();
    for (uint k = 0u; k < RUN; ++k) {
        uint i = block * BLOCK + t * RUN + k;
        if (i >= count) break;
        uint key = load_key(i), value = load_order(i);
        uint place = ranks[digit_of(key)][t]++;
        if (odd) {
            keys[place] = key;
            order[place] = value;
        } else {
            scratch[place] = key;
            scratch[count + place] = value;
        }
    }
}
