// Writes what is behind the splats: backgrounds that differ between views, and meshes.
#include "frame.glsl"
#if OCCLUDED || SAMPLED
#include "mesh_layer.glsl"
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
    vec4 mesh = mesh_colour_at(pixel, layer);
    if (mesh.a > 0.0) {
#if SAMPLED
        // coverage 0 or 1, by the pixel's centre: the splats behind a partly covered pixel are not drawn yet
        vec4 samples = mesh_samples_at(pixel, layer);
        if (samples.a > 0.0) mesh.rgb = samples.rgb / samples.a;
#endif
        fragment = mesh;
#if DEPTH
        depth = vec4(mesh_z_at(pixel, layer), 1.0, 0.0, 1.0);
#endif
    }
#elif SAMPLED
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 mesh = mesh_samples_at(pixel, layer);
    fragment = vec4(mesh.rgb + (1.0 - mesh.a) * fragment.rgb, mesh.a);
#if DEPTH
    depth = vec4(mesh_z_at(pixel, layer), mesh.a, 0.0, 1.0);
#endif
#endif
}
