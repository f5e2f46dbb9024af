// What lies behind the splats: the views' backgrounds where a plain clear cannot tell them apart, and meshes.
#include "frame.glsl"
#if OCCLUDED
uniform sampler2D mesh_colour;  // the views one below the other; alpha 0 where no mesh is
uniform sampler2D mesh_z;       // metres
#endif

flat in int layer;
layout(location = 0) out vec4 fragment;
#if DEPTH
layout(location = 1) out vec4 depth;
#endif

void main() {
    fragment = vec4(frame.views[layer].background.rgb, 0.0);
#if DEPTH
    depth = vec4(0.0);
#endif
#if OCCLUDED
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    pixel.y += layer * (textureSize(mesh_z, 0).y / VIEWS);
    vec4 mesh = texelFetch(mesh_colour, pixel, 0);
    if (mesh.a > 0.0) {
        fragment = mesh;
#if DEPTH
        depth = vec4(texelFetch(mesh_z, pixel, 0).r, 0.0, 0.0, 1.0);
#endif
    }
#endif
}
