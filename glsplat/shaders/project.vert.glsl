// Project pass, in sorted order: one record a splat with the footprints of all views, captured by transform feedback.
// What the views share comes first. Layout twin: record_layout in passes/project.py.
#include "frame.glsl"
#include "extent.glsl"
#include "covariance.glsl"
#include "splat_input.glsl"
#include "project.glsl"
#include "sh.glsl"

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

void main() {
    mat3 shape = input_shape();
#if SHARED_RGB
    rgb = evaluate_sh(vec3(0.0));
#endif
#if SHARED_ALPHA
    alpha = min(mean_opacity.w, 1.0);
#endif
    for (int v = 0; v < VIEWS; ++v) {
        Footprint foot;
        bool drawn = project(mean_opacity.xyz, shape, mean_opacity.w, v, foot) == VISIBLE;
        centre[v] = drawn ? foot.centre : vec2(-1.0);
        cholesky[v] = drawn ? foot.cholesky : vec3(0.0);
#if !SHARED_RGB
        vec3 direction = mean_opacity.xyz - frame.views[v].eye.xyz;
        rgb[v] = evaluate_sh(canonical_direction(direction * inversesqrt(max(dot(direction, direction), 1e-30))));
#endif
#if !SHARED_ALPHA
        alpha[v] = foot.alpha;
#endif
    }
    gl_Position = vec4(0.0);
}
