// Counts the digits of each group's span. Pass 0 leaves culled splats out, counts them, and sums the costs of all.
layout(local_size_x = 256) in;
#include "radix.glsl"

uniform uint views;
uniform uint corners;  // vertices per splat and view, if the draw is one instance; else 0

shared uint bins[DIGITS + 8u];  // digits, then codes of culled splats
shared uint cost_low, cost_high, low, high;

// Count the keys of a span; sum their costs in 64 bits, with a carry.
void count_keys(uvec2 span) {
    uint least = 0xFFFFFFFFu, most = 0u, sum_low = 0u, sum_high = 0u;
    for (uint i = span.x + gl_LocalInvocationIndex; i < span.y; i += THREADS) {
        uint key = scratch[3u * shown_at(i)], cost = scratch[3u * shown_at(i) + 2u];
        bool visible = key < FIRST_CULLED;
        // the lowest digit of depth_of(key), before the farthest key is known
        atomicAdd(bins[visible ? ~(key >> ignored_bits) & 255u : DIGITS + (key - FIRST_CULLED) % 8u], 1u);
        least = visible ? min(least, key) : least;
        most = visible ? max(most, key) : most;
        sum_low += cost;
        sum_high += uint(sum_low < cost);
    }
    atomicMin(low, least);
    atomicMax(high, most);
    uint before = atomicAdd(cost_low, sum_low);
    atomicAdd(cost_high, sum_high + uint(before + sum_low < before));
}

// Add the counts of this group to those of all.
void publish(uint splats) {
    for (uint code = 0u; code < 8u; ++code) {
        if (bins[DIGITS + code] > 0u) atomicAdd(culled[code], bins[DIGITS + code]);
        splats -= bins[DIGITS + code];
    }
    atomicAdd(drawn, splats);
    if (corners > 0u) atomicAdd(vertices, splats * views * corners);
    else atomicAdd(instances, splats * views);
    atomicMin(nearest, low);
    atomicMax(farthest, high);
    uint before = atomicAdd(blocks_low, cost_low);
    atomicAdd(blocks_high, cost_high + uint(before + cost_low < before));
}

void main() {
    uint t = gl_LocalInvocationIndex;
    if (digit > 0u && digit > last_digit()) return;
    bins[t] = 0u;
    if (t < 8u) bins[DIGITS + t] = 0u;
    if (t == 0u) {
        cost_low = cost_high = high = 0u;
        low = 0xFFFFFFFFu;
    }
    sync();
    uvec2 span = group_span();
    if (digit == 0u) {
        count_keys(span);
    } else {
        uint depths = list_of(digit - 1u);
        for (uint i = span.x + t; i < span.y; i += THREADS) atomicAdd(bins[digit_of(scratch[depths + i])], 1u);
    }
    sync();
    histogram[gl_WorkGroupID.x * DIGITS + t] = bins[t];
    if (digit == 0u && t == 0u) publish(span.y - span.x);
}
