// Converts the float target to 8 bit, without gamma: the fixed-point target rounds after this clamp.
// Views are stacked vertically: rows [v H, (v + 1) H) of the 8-bit target are layer v.
#if CULL_HIDDEN
#include "lift.glsl"
uniform vec3 background;  // of the resolved view
#endif
#include "step.glsl"
uniform sampler2DArray target;
uniform ivec3 view;  // layer, and its first column and row in the 8-bit target
out vec4 fragment;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy) - view.yz;
    vec4 colour = texelFetch(target, ivec3(pixel, view.x), 0);
#if CULL_HIDDEN
    colour = lifted(colour, background);
#endif
    fragment = clamp(stepped(colour, pixel), 0.0, 1.0);
}
