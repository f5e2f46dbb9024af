// What lies behind the splats: the views' backgrounds where a plain clear cannot tell them apart, and meshes.
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
        // all or nothing, by the centre: what splats would show through the rest of the pixel is not known here
        vec4 samples = mesh_samples_at(pixel, layer);
        if (samples.a > 0.0) mesh.rgb = samples.rgb / samples.a;
#endif
        fragment = mesh;
#if DEPTH
        depth = vec4(mesh_z_at(pixel, layer), 0.0, 0.0, 1.0);
#endif
    }
#elif SAMPLED
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 mesh = mesh_samples_at(pixel, layer);
    fragment = vec4(mesh.rgb + (1.0 - mesh.a) * fragment.rgb, mesh.a);
#if DEPTH
    depth = vec4(mesh_z_at(pixel, layer), 0.0, 0.0, 1.0);
#endif
#endif
}
