// The texture's colour, opaque, and the camera z. Colours are as stored, without gamma; light on vertices needs it.
#if LOGARITHMIC
#include "frame.glsl"
#endif
#include "cutout.glsl"
#if SHADED
#include "srgb.glsl"
in vec3 surface_shade;
#endif

uniform sampler2D skin_texture;  // rgb premultiplied by alpha, so that mip maps do not mix in what is cut away
uniform float lowest;

in vec2 surface_uv;
centroid in float surface_z;  // never beyond the triangle's edge, where its plane may lead anywhere
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
    // a millionth of z everywhere from the near plane on, where 24 bits of 1 / z have cm at 100 m
    gl_FragDepth = clamp(log2(surface_z / range.x) / 27.0, 0.0, 1.0);
#endif
}
