// Project pass, in sorted order: one record per splat with its footprints in all views, by transform feedback. Shared
// values come first. Layout twin: record_layout in variant.py. One varying per view, as ANGLE cannot capture arrays.
#include "frame.glsl"
#include "extent.glsl"
#include "covariance.glsl"
#include "splat_input.glsl"
#include "project.glsl"
#include "sh.glsl"
#if LIT
#include "light.glsl"
#endif

in uint order;  // index of the splat, far to near
out vec3 rgb0;
out float alpha0;
out vec2 centre0;
out vec3 cholesky0;  // zero, a quad without area, if this view culls the splat
out float z0;        // of the mean, in metres
#if VIEWS > 1
out vec3 rgb1;
out float alpha1;
out vec2 centre1;
out vec3 cholesky1;
out float z1;
#endif

// Return the values of a splat in view v.
void see(Splat splat, int index, int v, out vec3 rgb, out float alpha, out vec2 centre, out vec3 cholesky, out float z) {
    Footprint foot;
    bool drawn = project(splat.mean, splat.shape, splat.opacity, v, foot) == VISIBLE;
    centre = drawn ? foot.centre : vec2(-1.0);
    cholesky = drawn ? foot.cholesky : vec3(0.0);
#if SHARED_RGB
    rgb = evaluate_sh(index, vec3(0.0));
#else
    vec3 direction = splat.mean - frame.views[v].eye.xyz;
    direction *= inversesqrt(max(dot(direction, direction), 1e-30));
    rgb = evaluate_sh(index, canonical_direction(direction, splat.turn));
#endif
#if SHARED_ALPHA
    alpha = min(splat.opacity, 1.0);
#else
    alpha = foot.alpha;
#endif
    z = foot.z;
}

void main() {
    int index = int(order);
    Splat splat = splat_of(index);
    see(splat, index, 0, rgb0, alpha0, centre0, cholesky0, z0);
#if LIT
    vec3 shade = shading(index, splat.shape);
    rgb0 = lit(rgb0, shade);
#endif
#if VIEWS > 1
    see(splat, index, 1, rgb1, alpha1, centre1, cholesky1, z1);
#if LIT && !SHARED_RGB
    rgb1 = lit(rgb1, shade);
#endif
#endif
    gl_Position = vec4(0.0);
}
