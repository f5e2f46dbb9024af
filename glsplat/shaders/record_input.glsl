// The record of an instance as attributes: one record serves all views (divisor = VIEWS), a view picks its part.
// Layout twin: record_layout in passes/frame/project.py.
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

struct Record {
    vec2 centre;
    vec3 cholesky;
    vec4 colour;  // rgb, alpha
    float z;      // of the mean, in metres
};

Record record_of(int view) {
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
