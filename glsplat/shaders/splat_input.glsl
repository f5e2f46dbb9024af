// A splat as the key and project passes see it: static attributes, or what the skin pass wrote.
#if INFLUENCES > 0
in vec4 mean_opacity;
#if KEEP_ROTATION
in vec4 shape_x, shape_y, shape_z;  // columns of M; w: modified Rodrigues parameters of R_i
#else
in vec3 shape_x, shape_y, shape_z;
#endif
mat3 input_shape() { return mat3(shape_x.xyz, shape_y.xyz, shape_z.xyz); }
#else
in vec4 mean_opacity;
in vec4 quat;  // wxyz
in vec3 scale;
mat3 input_shape() { return shape_matrix(quat, scale); }
#endif

// A view direction in the frame in which the splat's SH was made (paper: R_i^T d under skinning).
vec3 canonical_direction(vec3 d) {
#if KEEP_ROTATION
    vec3 r = vec3(shape_x.w, shape_y.w, shape_z.w);
    float s = dot(r, r);
    vec4 q = vec4(1.0 - s, 2.0 * r) / (1.0 + s);
    return d * quaternion_matrix(q);
#else
    return d;
#endif
}
