// Colour of a splat in a direction: 3DGS basis and signs. Twin: reference.evaluate_sh.
// Coefficients are in texels of 4 floats (3 at degree 0) in order [coefficient][rgb]; the scene's highest degree
// determines how many are stored, SH_DEGREE how many are read.
#include "arena.glsl"
uniform sampler2D colours;

#if SH_DEGREE == 0
vec3 evaluate_sh(int index, vec3 d) {
    vec3 sh0 = texelFetch(colours, texel_of(index, COLOUR_TEXELS), 0).xyz;
    return clamp(0.28209479177387814 * sh0 + 0.5, 0.0, 1e30);
}
#else
vec4 coefficients(ivec2 at, int i) { return texelFetch(colours, at + ivec2(i, 0), 0); }

vec3 evaluate_sh(int index, vec3 d) {
    ivec2 at = texel_of(index, COLOUR_TEXELS);
    vec4 sh0 = coefficients(at, 0), sh1 = coefficients(at, 1), sh2 = coefficients(at, 2);
    float x = d.x, y = d.y, z = d.z;
    vec3 colour = 0.28209479177387814 * sh0.xyz;
    colour += 0.4886025119029199
        * (-y * vec3(sh0.w, sh1.xy) + z * vec3(sh1.zw, sh2.x) - x * sh2.yzw);
#if SH_DEGREE > 1
    vec4 sh3 = coefficients(at, 3), sh4 = coefficients(at, 4), sh5 = coefficients(at, 5), sh6 = coefficients(at, 6);
    float xx = x * x, yy = y * y, zz = z * z;
    colour += 1.0925484305920792 * x * y * sh3.xyz;
    colour -= 1.0925484305920792 * y * z * vec3(sh3.w, sh4.xy);
    colour += 0.31539156525252005 * (2.0 * zz - xx - yy) * vec3(sh4.zw, sh5.x);
    colour -= 1.0925484305920792 * x * z * sh5.yzw;
    colour += 0.5462742152960396 * (xx - yy) * sh6.xyz;
#endif
#if SH_DEGREE > 2
    vec4 sh7 = coefficients(at, 7), sh8 = coefficients(at, 8), sh9 = coefficients(at, 9);
    vec4 sh10 = coefficients(at, 10), sh11 = coefficients(at, 11);
    colour -= 0.5900435899266435 * y * (3.0 * xx - yy) * vec3(sh6.w, sh7.xy);
    colour += 2.890611442640554 * x * y * z * vec3(sh7.zw, sh8.x);
    colour -= 0.4570457994644658 * y * (4.0 * zz - xx - yy) * sh8.yzw;
    colour += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * sh9.xyz;
    colour -= 0.4570457994644658 * x * (4.0 * zz - xx - yy) * vec3(sh9.w, sh10.xy);
    colour += 1.445305721320277 * z * (xx - yy) * vec3(sh10.zw, sh11.x);
    colour -= 0.5900435899266435 * x * (xx - 3.0 * yy) * sh11.yzw;
#endif
    return clamp(colour + 0.5, 0.0, 1e30);  // the contract has no upper bound; this one keeps infinity out of blending
}
#endif
