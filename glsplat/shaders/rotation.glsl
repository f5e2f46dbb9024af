// R_i: the nearest rotation to a blended 3x3, continuous through a collapse. Twin: reference.blended_rotations, whose
// docstring explains it. The 32nd power is five squarings of a symmetric matrix, stored as diagonal and upper triangle.
struct Symmetric { vec4 diagonal; vec3 w; vec3 o; };  // w: (01, 02, 03), o: (12, 13, 23)

Symmetric davenport(mat3 m) {  // q^T Q q = trace(R(q)^T m) for unit q = wxyz; m[column][row]
    float x = m[0][0], y = m[1][1], z = m[2][2];
    return Symmetric(
        vec4(x + y + z, x - y - z, y - x - z, z - x - y),
        vec3(m[1][2] - m[2][1], m[2][0] - m[0][2], m[0][1] - m[1][0]),
        vec3(m[1][0] + m[0][1], m[2][0] + m[0][2], m[2][1] + m[1][2]));
}

Symmetric squared(Symmetric s) {
    vec4 d = s.diagonal;
    vec3 w = s.w, o = s.o, ww = w * w, oo = o * o;
    return Symmetric(
        d * d + vec4(ww.x + ww.y + ww.z, ww.x + oo.x + oo.y, ww.y + oo.x + oo.z, ww.z + oo.y + oo.z),
        w * (d.x + d.yzw) + vec3(w.y * o.x + w.z * o.y, w.x * o.x + w.z * o.z, w.x * o.y + w.y * o.z),
        o * (d.yyz + d.zww) + vec3(w.x * w.y + o.y * o.z, w.x * w.z + o.x * o.z, w.y * w.z + o.x * o.y));
}

vec4 product(Symmetric s, vec4 v) {
    return s.diagonal * v
        + vec4(dot(s.w, v.yzw), s.w.x * v.x + s.o.x * v.z + s.o.y * v.w, s.w.y * v.x + s.o.x * v.y + s.o.z * v.w,
            s.w.z * v.x + s.o.y * v.y + s.o.z * v.z);
}

vec4 dominant_column(Symmetric s) {  // the column with the largest diagonal entry, at unit length
    vec4 d = s.diagonal;
    vec4 column = d.x >= d.y ? vec4(d.x, s.w) : vec4(s.w.x, d.y, s.o.xy);
    vec4 other = d.z >= d.w ? vec4(s.w.y, s.o.x, d.z, s.o.z) : vec4(s.w.z, s.o.yz, d.w);
    column = max(d.x, d.y) >= max(d.z, d.w) ? column : other;
    return column * inversesqrt(max(dot(column, column), 1e-30));
}

vec4 blended_quaternion(mat3 blended, mat3 anchor, float shift) {  // wxyz, w >= 0
    float size = sqrt((dot(blended[0], blended[0]) + dot(blended[1], blended[1]) + dot(blended[2], blended[2])) / 3.0);
    Symmetric power = davenport(blended * (0.5 / max(size, 1.0)));
    power.diagonal += 0.5 * shift;  // eigenvalues 0 to 3, the largest at least 0.5: the 32nd power needs no scaling
    for (int i = 0; i < 5; ++i) power = squared(power);
    vec4 column = dominant_column(power);
    Symmetric start = davenport(anchor);
    start.diagonal += 1.0;
    vec4 toward = product(power, dominant_column(start)) / dot(power.diagonal, vec4(1.0));
    vec4 q = toward + (dot(toward, column) < 0.0 ? -1e-3 : 1e-3) * column;
    q *= inversesqrt(max(dot(q, q), 1e-30));
    return q.x < 0.0 ? -q : q;
}
