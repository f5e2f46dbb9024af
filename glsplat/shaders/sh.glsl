// Colour of a splat in a direction: 3DGS basis and signs. Twin: reference.evaluate_sh.
// The coefficients arrive as vec4 attributes sh0, sh1, ... holding floats in order [coefficient][rgb].
#if SH_DEGREE == 0
in vec3 sh0;
vec3 evaluate_sh(vec3 d) { return clamp(0.28209479177387814 * sh0 + 0.5, 0.0, 1e30); }
#else
in vec4 sh0, sh1, sh2;
#if SH_DEGREE > 1
in vec4 sh3, sh4, sh5, sh6;
#endif
#if SH_DEGREE > 2
in vec4 sh7, sh8, sh9, sh10, sh11;
#endif

vec3 evaluate_sh(vec3 d) {
    float x = d.x, y = d.y, z = d.z;
    vec3 colour = 0.28209479177387814 * sh0.xyz;
    colour += 0.4886025119029199
        * (-y * vec3(sh0.w, sh1.xy) + z * vec3(sh1.zw, sh2.x) - x * sh2.yzw);
#if SH_DEGREE > 1
    float xx = x * x, yy = y * y, zz = z * z;
    colour += 1.0925484305920792 * x * y * sh3.xyz;
    colour -= 1.0925484305920792 * y * z * vec3(sh3.w, sh4.xy);
    colour += 0.31539156525252005 * (2.0 * zz - xx - yy) * vec3(sh4.zw, sh5.x);
    colour -= 1.0925484305920792 * x * z * sh5.yzw;
    colour += 0.5462742152960396 * (xx - yy) * sh6.xyz;
#endif
#if SH_DEGREE > 2
    colour -= 0.5900435899266435 * y * (3.0 * xx - yy) * vec3(sh6.w, sh7.xy);
    colour += 2.890611442640554 * x * y * z * vec3(sh7.zw, sh8.x);
    colour -= 0.4570457994644658 * y * (4.0 * zz - xx - yy) * sh8.yzw;
    colour += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * sh9.xyz;
    colour -= 0.4570457994644658 * x * (4.0 * zz - xx - yy) * vec3(sh9.w, sh10.xy);
    colour += 1.445305721320277 * z * (xx - yy) * vec3(sh10.zw, sh11.x);
    colour -= 0.5900435899266435 * x * (xx - 3.0 * yy) * sh11.yzw;
#endif
    return clamp(colour + 0.5, 0.0, 1e30);  // no upper bound in the contract; this one keeps infinity out of blending
}
#endif
