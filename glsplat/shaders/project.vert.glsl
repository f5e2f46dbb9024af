// Project pass, in sorted order: one record a splat with the footprints of all views, captured by transform feedback.
// What the views share comes first. Layout twin: record_layout in passes/frame/project.py.
#include "frame.glsl"
#include "extent.glsl"
#include "covariance.glsl"
#include "splat_input.glsl"
#include "project.glsl"
#include "sh.glsl"

in uint order;  // the index of the splat; far to near
#if SHARED_RGB
out vec3 rgb;
#else
out vec3 rgb[VIEWS];
#endif
#if SHARED_ALPHA
out float alpha;
#else
out float alpha[VIEWS];
#endif
out vec2 centre[VIEWS];
out vec3 cholesky[VIEWS];  // zero where this view does not draw the splat: a quad without area
#if DEPTH || OCCLUDED
out float z[VIEWS];  // of the mean, in metres
#endif

void main() {
    int index = int(order);
    Splat splat = splat_of(index);
#if SHARED_RGB
    rgb = evaluate_sh(index, vec3(0.0));
#endif
#if SHARED_ALPHA
    alpha = min(splat.opacity, 1.0);
#endif
    for (int v = 0; v < VIEWS; ++v) {
        Footprint foot;
        bool drawn = project(splat.mean, splat.shape, splat.opacity, v, foot) == VISIBLE;
        centre[v] = drawn ? foot.centre : vec2(-1.0);
        cholesky[v] = drawn ? foot.cholesky : vec3(0.0);
#if !SHARED_RGB
        vec3 direction = splat.mean - frame.views[v].eye.xyz;
        direction *= inversesqrt(max(dot(direction, direction), 1e-30));
        rgb[v] = evaluate_sh(index, canonical_direction(direction, splat.turn));
#endif
#if !SHARED_ALPHA
        alpha[v] = foot.alpha;
#endif
#if DEPTH || OCCLUDED
        z[v] = foot.z;
#endif
    }
    gl_Position = vec4(0.0);
}
