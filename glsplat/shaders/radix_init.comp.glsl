// Inverts the keys to "far first", writes indices in reverse (at equal keys the lower index is nearer, drawn later) and
// counts. Sums the costs of the splats: key.vert.glsl left pairs (bounds, cost) in the scratch buffer.
layout(local_size_x = 256) in;
#include "radix.glsl"

layout(std430, binding = 4) buffer Draw {
    uint vertices, instances, first, base;  // of an indirect draw
    uint culled[8];                         // by the codes of project.glsl
    uint blocks_low, blocks_high;           // 4x4 pixels each, over all splats
};
uniform uint views;
uniform uint corners;  // vertices per splat and view, if the draw is one instance; else 0

shared uint blocks;  // sum of this group: fits 32 bits, as 512 splats have at most 2^23 (two views of 8192^2)

void main() {
    if (gl_LocalInvocationIndex == 0u) blocks = 0u;
    barrier();
    uint i = gl_GlobalInvocationID.x;
    // one invocation handles the pair (i, mirror), so that each key is read before it is overwritten
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
        if (before + blocks < before) atomicAdd(blocks_high, 1u);  // carry of a 64-bit sum
    }
}
