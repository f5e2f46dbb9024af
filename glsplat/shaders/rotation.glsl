// R_i: the nearest rotation to a blended 3x3, continuous through a collapse. Twin: reference.blended_rotations,
// whose docstring has the reasoning; here the 32nd power is five squarings.
mat4 davenport(mat3 m) {  // q^T Q q = trace(R(q)^T m) for unit q = wxyz; m[column][row]
    float wx = m[1][2] - m[2][1], wy = m[2][0] - m[0][2], wz = m[0][1] - m[1][0];
    float xy = m[1][0] + m[0][1], xz = m[2][0] + m[0][2], yz = m[2][1] + m[1][2];
    return mat4(
        m[0][0] + m[1][1] + m[2][2], wx, wy, wz,
        wx, m[0][0] - m[1][1] - m[2][2], xy, xz,
        wy, xy, m[1][1] - m[0][0] - m[2][2], yz,
        wz, xz, yz, m[2][2] - m[0][0] - m[1][1]);
}

vec4 dominant_column(mat4 m) {  // the column with the largest diagonal entry, at unit length
    vec4 column = m[0];
    float best = m[0][0];
    for (int i = 1; i < 4; ++i) {
        if (m[i][i] > best) {
            best = m[i][i];
            column = m[i];
        }
    }
    return column * inversesqrt(max(dot(column, column), 1e-30));
}

vec4 blended_quaternion(mat3 blended, mat3 strongest, float shift) {  // wxyz, w >= 0
    float size = sqrt((dot(blended[0], blended[0]) + dot(blended[1], blended[1]) + dot(blended[2], blended[2])) / 3.0);
    mat4 power = davenport(blended / max(size, 1.0)) + mat4(shift);
    for (int i = 0; i < 5; ++i) {
        power *= 1.0 / max(power[0][0] + power[1][1] + power[2][2] + power[3][3], 1e-30);
        power = power * power;
    }
    power *= 1.0 / max(power[0][0] + power[1][1] + power[2][2] + power[3][3], 1e-30);
    vec4 toward = power * dominant_column(davenport(strongest) + mat4(1.0));
    vec4 column = dominant_column(power);
    vec4 q = toward + (dot(toward, column) < 0.0 ? -1e-3 : 1e-3) * column;
    q *= inversesqrt(max(dot(q, q), 1e-30));
    return q.x < 0.0 ? -q : q;
}
