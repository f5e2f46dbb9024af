// Fetches a splat for the key and project passes: at rest as loaded, or POSED by the skin or place pass.
#include "arena.glsl"
uniform sampler2D splats;

struct Splat {
    vec3 mean;      // relative to the scene's origin
    float opacity;  // under ANTIALIAS 2 negative if the splat requests opacity compensation
    mat3 shape;     // M, Sigma = M M^T
    vec3 turn;      // modified Rodrigues parameters of R_i
};

Splat splat_of(int index) {
#if POSED
    ivec2 at = texel_of(index, 4);
    vec4 mean_opacity = texelFetch(splats, at, 0);
    vec4 x = texelFetch(splats, at + ivec2(1, 0), 0);
    vec4 y = texelFetch(splats, at + ivec2(2, 0), 0);
    vec4 z = texelFetch(splats, at + ivec2(3, 0), 0);
    return Splat(mean_opacity.xyz, mean_opacity.w, mat3(x.xyz, y.xyz, z.xyz), vec3(x.w, y.w, z.w));
#else
    ivec2 at = texel_of(index, 3);
    vec4 mean_opacity = texelFetch(splats, at, 0);
    vec4 quat = texelFetch(splats, at + ivec2(1, 0), 0);  // wxyz
    vec3 scale = texelFetch(splats, at + ivec2(2, 0), 0).xyz;
    return Splat(mean_opacity.xyz, mean_opacity.w, shape_matrix(quat, scale), vec3(0.0));
#endif
}

// Return a view direction in the canonical frame of the splat's SH (paper: R_i^T d under skinning).
vec3 canonical_direction(vec3 d, vec3 turn) {
#if TURNED
    float s = dot(turn, turn);
    vec4 q = vec4(1.0 - s, 2.0 * turn) / (1.0 + s);
    return d * quaternion_matrix(q);
#else
    return d;
#endif
}
