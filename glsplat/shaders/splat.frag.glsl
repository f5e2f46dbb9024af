// Gaussian falloff, premultiplied; blending is ONE, ONE_MINUS_SRC_ALPHA. Twin: reference.composite.
#if CUT
#include "frame.glsl"
#endif
#if OCCLUDED
#include "mesh_layer.glsl"
flat in int splat_layer;
#endif
flat in vec4 splat_colour;
in vec2 splat_offset;
#if DEPTH || OCCLUDED
flat in float splat_z;
#endif
layout(location = 0) out vec4 fragment;
#if DEPTH
layout(location = 1) out vec4 depth;  // weight times z, and weight; alpha is for blending only
#endif

void main() {
    float distance2 = dot(splat_offset, splat_offset);
    float alpha = min(0.99, splat_colour.a * exp(-0.5 * distance2));
    // blending zero keeps the pixel bit-identical; a discard costs llvmpipe 4 % of the frame
    alpha = alpha < 1.0 / 255.0 ? 0.0 : alpha;
#if CUT
    alpha = distance2 > frame.knobs.y * frame.knobs.y ? 0.0 : alpha;
#endif
#if OCCLUDED
    alpha = splat_z > mesh_z_at(ivec2(gl_FragCoord.xy), splat_layer) ? 0.0 : alpha;
#endif
    fragment = vec4(splat_colour.rgb * alpha, alpha);
#if DEPTH
    depth = vec4(splat_z * alpha, alpha, 0.0, alpha);
#endif
}
