// Writes the texture's opaque colour and the camera z. Colours stay in sRGB; only vertex light is applied linearly.
#if LOGARITHMIC
#include "frame.glsl"
#endif
#include "cutout.glsl"
#if SHADED
#include "srgb.glsl"
in vec3 surface_shade;
#endif

uniform sampler2D skin_texture;  // premultiplied, so that mip maps do not mix in the colour of holes
uniform float lowest;

in vec2 surface_uv;
centroid in float surface_z;  // centroid: extrapolation beyond the triangle's edge is unbounded
layout(location = 0) out vec4 colour;
layout(location = 1) out vec4 z;

void main() {
    vec4 texel = texture(skin_texture, bounded(surface_uv, dFdx(surface_uv), dFdy(surface_uv)));
    colour = cut_out(texel, fwidth(texel.a), lowest);
    if (colour.a == 0.0) discard;
#if SHADED
    colour.rgb = srgb_of(linear_of(colour.rgb) * max(surface_shade, 0.0));
#endif
    z = vec4(surface_z, 0.0, 0.0, 1.0);
#if LOGARITHMIC
    vec4 range = frame.views[0].range;
    if (surface_z > range.y) discard;
    // resolves a millionth of z at any distance; 24 bits of 1 / z would resolve centimetres at 100 m
    gl_FragDepth = clamp(log2(surface_z / range.x) / 27.0, 0.0, 1.0);
#endif
}
