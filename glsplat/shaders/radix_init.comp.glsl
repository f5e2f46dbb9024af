// Keys to "far first", indices from the back (of equal keys the lower index is the nearer, drawn later), and counts.
layout(local_size_x = 256) in;
#include "radix.glsl"

layout(std430, binding = 4) buffer Draw {
    uint vertices, instances, first, base;  // of an indirect draw
    uint culled[8];                         // by the codes of project.glsl
};
uniform uint views;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= count) return;
    // the pair (i, mirror) is handled by one invocation: each key is read before it is overwritten
    uint mirror = count - 1u - i;
    if (i > mirror) return;
    uint a = keys[i], b = keys[mirror];
    for (int k = 0; k < 2; ++k) {
        uint key = k == 0 ? b : a;
        uint place = k == 0 ? i : mirror;
        if (k == 1 && i == mirror) break;
        bool drawn = key < 0xFFFFFF00u;
        keys[place] = drawn ? ~key : 0xFFFFFFFFu;
        order[place] = count - 1u - place;
        if (drawn) atomicAdd(instances, views);
        else atomicAdd(culled[min(key - 0xFFFFFF00u, 7u)], 1u);
    }
}
