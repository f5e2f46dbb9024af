// The texture's colour as it is, without light and gamma; or times the vertices' light, which needs the gamma.
#include "cutout.glsl"
#if SHADED
#include "srgb.glsl"
in vec3 surface_shade;  // factors in linear light
#endif

uniform sampler2D skin_texture;  // rgb premultiplied by alpha, so that mip maps do not mix in what is cut away
uniform float lowest;

in vec2 surface_uv;
out vec4 fragment;

void main() {
    vec4 texel = texture(skin_texture, bounded(surface_uv, dFdx(surface_uv), dFdy(surface_uv)));
    fragment = cut_out(texel, fwidth(texel.a), lowest);
    if (fragment.a == 0.0) discard;
#if SHADED
    fragment.rgb = srgb_of(linear_of(fragment.rgb) * max(surface_shade, 0.0));
#endif
}
