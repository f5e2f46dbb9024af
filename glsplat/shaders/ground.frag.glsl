// The texture's colour as it is (no light, no gamma), opaque, and the camera z of the pixel's centre.
// Depth is logarithmic: a millionth of z everywhere from the near plane on, where 24 bits of 1 / z have cm at 100 m.
#include "frame.glsl"
uniform sampler2D skin_texture;  // rgb premultiplied by alpha, so that mip maps do not mix in what is cut away
uniform float lowest;            // alpha below which nothing is drawn: 0 for no holes, else 0.5

in vec2 surface_uv;
in float surface_z;
flat in int surface_view;
layout(location = 0) out vec4 colour;
layout(location = 1) out vec4 z;

void main() {
    vec4 texel = texture(skin_texture, surface_uv);
    vec4 range = frame.views[surface_view].range;
    if (texel.a < lowest || surface_z > range.y) discard;
    colour = vec4(lowest > 0.0 ? texel.rgb / max(texel.a, 1.0 / 255.0) : texel.rgb, 1.0);
    z = vec4(surface_z, 0.0, 0.0, 1.0);
    gl_FragDepth = clamp(log2(surface_z / range.x) / 27.0, 0.0, 1.0);
}
