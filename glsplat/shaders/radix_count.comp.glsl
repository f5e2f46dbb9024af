// Counts the digits of each block.
layout(local_size_x = 64) in;
#include "radix.glsl"

shared uint bins[16];

void main() {
    uint t = gl_LocalInvocationID.x, block = gl_WorkGroupID.x;
    if (t < 16u) bins[t] = 0u;
    barrier();
    for (uint k = 0u; k < RUN; ++k) {
        uint i = block * BLOCK + t * RUN + k;
        if (i < count) atomicAdd(bins[digit_of(load_key(i))], 1u);
    }
    barrier();
    if (t < 16u) histogram[t * groups + block] = bins[t];
}
