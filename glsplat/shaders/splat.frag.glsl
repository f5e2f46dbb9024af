// Gaussian falloff, premultiplied; blending is ONE, ONE_MINUS_SRC_ALPHA. Twin: reference.composite.
#if CUT
#include "frame.glsl"
#endif
#if OCCLUDED
uniform sampler2D mesh_z;  // camera z of the nearest mesh, in metres; the views one below the other
flat in int splat_layer;
#endif
flat in vec4 splat_colour;
in vec2 splat_offset;
#if DEPTH || OCCLUDED
flat in float splat_z;
#endif
layout(location = 0) out vec4 fragment;
#if DEPTH
layout(location = 1) out vec4 depth;  // weight times z; its alpha only blends
#endif

void main() {
    float distance2 = dot(splat_offset, splat_offset);
    float alpha = min(0.99, splat_colour.a * exp(-0.5 * distance2));
    // blending zero leaves the pixel as it is, bit for bit; a discard costs llvmpipe 4 % of the frame
    alpha = alpha < 1.0 / 255.0 ? 0.0 : alpha;
#if CUT
    alpha = distance2 > frame.knobs.y * frame.knobs.y ? 0.0 : alpha;
#endif
#if OCCLUDED
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    int rows = textureSize(mesh_z, 0).y / VIEWS;
    alpha = splat_z > texelFetch(mesh_z, ivec2(pixel.x, pixel.y + splat_layer * rows), 0).r ? 0.0 : alpha;
#endif
    fragment = vec4(splat_colour.rgb * alpha, alpha);
#if DEPTH
    depth = vec4(splat_z * alpha, 0.0, 0.0, alpha);
#endif
}
