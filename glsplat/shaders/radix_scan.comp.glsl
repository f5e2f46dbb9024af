// Exclusive prefix sum of the histogram, one work group.
layout(local_size_x = 256) in;
#include "radix.glsl"

shared uint sums[256];

void main() {
    uint t = gl_LocalInvocationID.x, total = 16u * groups, run = (total + 255u) / 256u;
    uint begin = min(t * run, total), end = min(begin + run, total), sum = 0u;
    for (uint i = begin; i < end; ++i) sum += histogram[i];
    sums[t] = sum;
    barrier();
    for (uint step = 1u; step < 256u; step <<= 1) {
        uint left = t >= step ? sums[t - step] : 0u;
        barrier();
        sums[t] += left;
        barrier();
    }
    uint before = sums[t] - sum;
    for (uint i = begin; i < end; ++i) {
        uint value = histogram[i];
        histogram[i] = before;
        before += value;
    }
}
