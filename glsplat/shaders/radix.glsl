// Buffers and spans of the radix sort (twin: renderer/gpu_sort.py): 8 bits a pass from the lowest, stable.
//
// Reduce, then scan: a fixed number of groups count the digits of their spans, and the next dispatch adds up the counts.
// A single pass with decoupled look-back (OneSweep) would wait for other groups of the same dispatch. OpenGL does not
// promise that those run meanwhile, and some drivers hang there. Ranks come from shared memory and full barriers alone:
// subgroups differ in width between drivers (4 to 64), or are missing.
layout(std430, binding = 0) readonly buffer Rows { uint rows[]; };  // of the arena that are shown
layout(std430, binding = 1) writeonly buffer Order { uint order[]; };
layout(std430, binding = 2) buffer Scratch { uint scratch[]; };  // key, bounds, cost; then two lists: depths, indices
layout(std430, binding = 3) buffer Histogram { uint histogram[]; };  // [groups][DIGITS]
layout(std430, binding = 4) buffer Counts {
    uint vertices, instances, first_vertex, first_instance;  // of the indirect draw
    uint drawn, one, first_point, first_again;               // the indirect project pass: splats to draw
    uint culled[8];                                          // splats by the codes of project.glsl
    uint blocks_low, blocks_high;                            // 4x4 pixels each, over all splats
    uint nearest, farthest;                                  // keys of drawn splats
};

uniform uint count;   // splats that are shown
uniform uint groups;  // of every dispatch
uniform uint digit;   // of this pass, 0 the lowest
uniform uint ignored_bits;  // low bits of a key that do not count

const uint THREADS = 256u;
const uint DIGITS = 256u;
const uint ROUNDS = 8u;
const uint TILE = THREADS * ROUNDS;
const uint FIRST_CULLED = 0xFFFFFF00u;

// Barrier for shared memory: barrier() alone orders it on most drivers, but GLSL 4.30 does not promise that.
void sync() {
    memoryBarrierShared();
    barrier();
}

// Return the depth below the farthest splat, whose lowest byte depends on the key alone.
uint depth_of(uint key) { return ((farthest >> ignored_bits) | 255u) - (key >> ignored_bits); }
uint digit_of(uint depth) { return (depth >> (8u * digit)) & 255u; }

// Return the number of the highest digit in which depths differ.
uint last_digit() { return uint(findMSB(depth_of(nearest) | 1u)) / 8u; }

// Return this group's part of all positions in the order, in whole tiles: its first, and the first after it.
uvec2 group_span() {
    uint total = digit == 0u ? count : drawn, tiles = (total + TILE - 1u) / TILE;
    uint share = (tiles + groups - 1u) / groups * TILE;
    return min(gl_WorkGroupID.x * share + uvec2(0u, share), total);
}

// Pass 0 starts with the last splat: of equal keys the lower index is nearer, so it is drawn later.
uint shown_at(uint position) { return count - 1u - position; }
// Pass n writes list n % 2, the last pass the order.
uint list_of(uint number) { return (3u + number % 2u * 2u) * count; }
