// A textured mesh alone.
#include "surface.glsl"
#if SHADED
in vec3 shade;
out vec3 surface_shade;
#endif

out vec2 surface_uv;

void main() {
    gl_Position = clip_place(camera_point());
    surface_uv = uv;
#if SHADED
    surface_shade = shade;
#endif
}
