// Mesh pass, which runs before any splat is drawn.
#include "surface.glsl"

out vec2 surface_uv;
centroid out float surface_z;  // camera z in metres
#if SHADED
in vec3 shade;  // factors in linear light
out vec3 surface_shade;
#endif

void main() {
    vec3 c = camera_point();
#if LOGARITHMIC
    gl_Position = vec4(image_place(c), c.z - 2.0 * frame.views[0].range.x, c.z);  // clipped at the near plane only
#else
    gl_Position = clip_place(c);
#endif
    surface_uv = uv;
    surface_z = c.z;
#if SHADED
    surface_shade = shade;
#endif
}
