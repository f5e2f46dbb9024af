// A splat as the key and project passes see it: at rest as it was loaded, or POSED by the pass of its item.
#include "arena.glsl"
uniform sampler2D splats;

struct Splat {
    vec3 mean;      // about the scene's origin
    float opacity;  // under ANTIALIAS 2 negative where the splat asks for opacity compensation
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

// A view direction in the frame in which the splat's SH was made (paper: R_i^T d under skinning).
vec3 canonical_direction(vec3 d, vec3 turn) {
#if TURNED
    float s = dot(turn, turn);
    vec4 q = vec4(1.0 - s, 2.0 * turn) / (1.0 + s);
    return d * quaternion_matrix(q);
#else
    return d;
#endif
}
