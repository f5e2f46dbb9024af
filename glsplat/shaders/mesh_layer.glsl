// Results of the mesh pass at a pixel. Each view has its own targets: in a shared target rounding would depend on the
// row, and a pair has to equal its single renders.
uniform sampler2D mesh_z;        // camera z of the nearest mesh at the pixel's centre, in metres; without splats its
                                 // mean over the pixel times coverage
uniform sampler2D mesh_colour;   // at the pixel's centre; alpha 0 without a mesh
uniform sampler2D mesh_samples;  // premultiplied mean of the samples; alpha is the coverage
#if VIEWS > 1
uniform sampler2D mesh_z_2, mesh_colour_2, mesh_samples_2;  // of the second view
#endif

float mesh_z_at(ivec2 pixel, int view) {
#if VIEWS > 1
    if (view > 0) return texelFetch(mesh_z_2, pixel, 0).r;
#endif
    return texelFetch(mesh_z, pixel, 0).r;
}

vec4 mesh_colour_at(ivec2 pixel, int view) {
#if VIEWS > 1
    if (view > 0) return texelFetch(mesh_colour_2, pixel, 0);
#endif
    return texelFetch(mesh_colour, pixel, 0);
}

#if SAMPLED
vec4 mesh_samples_at(ivec2 pixel, int view) {
    vec4 mean = texelFetch(mesh_samples, pixel, 0);
#if VIEWS > 1
    if (view > 0) mean = texelFetch(mesh_samples_2, pixel, 0);
#endif
    return vec4(mean.rgb, round(mean.a * float(SAMPLED)) / float(SAMPLED));  // eight bits cannot store a quarter
}
#endif
