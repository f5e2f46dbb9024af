// Expressions: adds the weighted shape entries of a splat before skinning. Twin: reference.expressed.
uniform usampler2D entries;  // one entry per texel: int16 x 3 of the mean, int8 x 6 of two axes, index of the shape
uniform sampler2D amounts;   // of shape k at (k, 0): Shapes.amounts
in uvec2 range;              // first entry of the splat, and one past the last

const uint ROW = 1024u;  // entries per row; twin: _ENTRIES_PER_ROW in renderer/stage.py

vec2 halves(uint v) { return vec2(int(v << 16) >> 16, int(v) >> 16); }

vec4 bytes(uint v) { return vec4(int(v << 24) >> 24, int(v << 16) >> 24, int(v << 8) >> 24, int(v) >> 24); }

mat3 expressed(inout vec3 mean, vec4 q, vec3 s) {  // M of the splat
    if (range.x == range.y) return shape_matrix(q, s);
    mat3 axes = quaternion_matrix(q);
    vec3 size = abs(s);
    int thin = size.x <= min(size.y, size.z) ? 0 : (size.y <= size.z ? 1 : 2);
    // constant indices only: softpipe writes the wrong column of a matrix if splats differ in the index
    vec3 a = thin == 2 ? axes[0] : (thin == 0 ? axes[1] : axes[2]);
    vec3 b = thin == 2 ? axes[1] : (thin == 0 ? axes[2] : axes[0]);
    vec3 moved = vec3(0.0);
    for (uint e = range.x; e < range.y; ++e) {
        uvec4 entry = texelFetch(entries, ivec2(int(e % ROW), int(e / ROW)), 0);
        vec2 amount = texelFetch(amounts, ivec2(int(entry.w), 0), 0).xy;
        if (amount.y == 0.0) continue;
        vec4 first = bytes(entry.y), rest = bytes(entry.z);
        moved += amount.x * vec3(halves(entry.x), halves(entry.y).x);
        a += amount.y * vec3(first.zw, rest.x);
        b += amount.y * rest.yzw;
    }
    mean += moved;
    vec3 normal = cross(a, b);
    normal /= max(length(normal), 1e-20);
    axes = thin == 2 ? mat3(a, b, normal) : (thin == 0 ? mat3(normal, a, b) : mat3(b, normal, a));
    return mat3(axes[0] * s.x, axes[1] * s.y, axes[2] * s.z);
}
