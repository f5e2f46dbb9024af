// Keys to "far first", indices from the back (of equal keys the lower index is the nearer, drawn later), and counts.
// Sums up what the splats cost: key.vert.glsl left pairs (tiles, cost) in the scratch space.
layout(local_size_x = 256) in;
#include "radix.glsl"

layout(std430, binding = 4) buffer Draw {
    uint vertices, instances, first, base;  // of an indirect draw
    uint culled[8];                         // by the codes of project.glsl
    uint blocks_low, blocks_high;           // of 4x4 pixels, over all splats
};
uniform uint views;
uniform uint corners;  // of a splat in a view, where they are all vertices of one instance; else 0

shared uint blocks;  // of this group: 512 splats of at most 2^23, two views of 8192^2

void main() {
    if (gl_LocalInvocationIndex == 0u) blocks = 0u;
    barrier();
    uint i = gl_GlobalInvocationID.x;
    // the pair (i, mirror) is handled by one invocation: each key is read before it is overwritten
    uint mirror = count - 1u - i;
    if (i < count && i <= mirror) {
        uint a = keys[i], b = keys[mirror];
        for (int k = 0; k < 2; ++k) {
            uint key = k == 0 ? b : a;
            uint place = k == 0 ? i : mirror;
            if (k == 1 && i == mirror) break;
            bool drawn = key < 0xFFFFFF00u;
            keys[place] = drawn ? ~key : 0xFFFFFFFFu;
            order[place] = count - 1u - place;
            atomicAdd(blocks, min(scratch[2u * place + 1u], 0x7FFFFFu));
            if (drawn && corners > 0u) atomicAdd(vertices, views * corners);
            else if (drawn) atomicAdd(instances, views);
            else atomicAdd(culled[min(key - 0xFFFFFF00u, 7u)], 1u);
        }
    }
    barrier();
    if (gl_LocalInvocationIndex == 0u) {
        uint before = atomicAdd(blocks_low, blocks);
        if (before + blocks < before) atomicAdd(blocks_high, 1u);  // 64 bits of two
    }
}
