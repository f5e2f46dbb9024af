// Reads one view's part of a record of the project pass. Layout twin: record_layout in variant.py.
struct Record {
    vec2 centre;
    vec3 cholesky;
    vec4 colour;  // rgb, alpha
    float z;      // of the mean, in metres
};

#if PULLED
// by index, from a storage buffer; from a texture in OpenGL ES 3.0, which has none
#if ES
uniform sampler2D records;  // R32F, rows of 4096 floats
float number_at(int i) { return texelFetch(records, ivec2(i & 4095, i >> 12), 0).r; }
#else
layout(std430, binding = 0) readonly buffer Records { float records[]; };
float number_at(int i) { return records[i]; }
#endif

Record record_of(int index, int view) {
    const int RGB = SHARED_RGB == 1 ? 3 : 3 * VIEWS;
    const int ALPHA = SHARED_ALPHA == 1 ? 1 : VIEWS;
    const int CENTRES = RGB + ALPHA, CHOLESKYS = CENTRES + 2 * VIEWS, ZS = CHOLESKYS + 3 * VIEWS;
#if DEPTH || OCCLUDED
    int at = index * (ZS + VIEWS);
#else
    int at = index * ZS;
#endif
    int rgb = at + 3 * view * (1 - SHARED_RGB), alpha = at + RGB + view * (1 - SHARED_ALPHA);
    int centre = at + CENTRES + 2 * view, cholesky = at + CHOLESKYS + 3 * view;
    Record r;
    r.centre = vec2(number_at(centre), number_at(centre + 1));
    r.cholesky = vec3(number_at(cholesky), number_at(cholesky + 1), number_at(cholesky + 2));
    r.colour = vec4(number_at(rgb), number_at(rgb + 1), number_at(rgb + 2), number_at(alpha));
#if DEPTH || OCCLUDED
    r.z = number_at(at + ZS + view);
#else
    r.z = 0.0;
#endif
    return r;
}
#else
// as instance attributes: one record serves all views (divisor = VIEWS)
in vec2 centre0;
in vec3 cholesky0;
#if VIEWS > 1
in vec2 centre1;
in vec3 cholesky1;
#endif
in vec3 rgb0;
#if VIEWS > 1 && !SHARED_RGB
in vec3 rgb1;
#endif
in float alpha0;
#if VIEWS > 1 && !SHARED_ALPHA
in float alpha1;
#endif

#if DEPTH || OCCLUDED
in float z0;
#if VIEWS > 1
in float z1;
#endif
#endif

Record record_of(int index, int view) {
    Record r = Record(centre0, cholesky0, vec4(rgb0, alpha0), 0.0);
#if DEPTH || OCCLUDED
    r.z = z0;
#endif
#if VIEWS > 1
    if (view == 1) {
        r.centre = centre1;
        r.cholesky = cholesky1;
#if !SHARED_RGB
        r.colour.rgb = rgb1;
#endif
#if !SHARED_ALPHA
        r.colour.a = alpha1;
#endif
#if DEPTH || OCCLUDED
        r.z = z1;
#endif
    }
#endif
    return r;
}
#endif
