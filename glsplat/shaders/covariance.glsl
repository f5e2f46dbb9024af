// Shape of a splat: M = R(q) diag(s), Sigma = M M^T. Twin: reference.quaternion_matrices, reference.rest.
mat3 quaternion_matrix(vec4 q) {  // q = wxyz, unit
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(  // columns
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

mat3 shape_matrix(vec4 q, vec3 s) {
    mat3 r = quaternion_matrix(q);
    return mat3(r[0] * s.x, r[1] * s.y, r[2] * s.z);
}
