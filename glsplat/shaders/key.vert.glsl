// Key pass: depth as a sortable uint, nearest first, or why no view draws the splat.
#include "frame.glsl"
#include "extent.glsl"
#include "covariance.glsl"
#include "splat_input.glsl"
#include "project.glsl"

flat out uint key;

void main() {
    mat3 shape = input_shape();
    Footprint foot;
    uint reason = project(mean_opacity.xyz, shape, mean_opacity.w, 0, foot);
    for (int v = 1; v < VIEWS; ++v) reason = min(reason, project(mean_opacity.xyz, shape, mean_opacity.w, v, foot));
    // IEEE floats compare like integers once the sign is undone; codes lie above every finite key
    uint bits = floatBitsToUint(dot(frame.sort_row.xyz, mean_opacity.xyz) + frame.sort_row.w);
    bits = (bits & 0x80000000u) != 0u ? ~bits : bits | 0x80000000u;
    key = reason == VISIBLE ? min(bits, 0xFFFFFEFFu) : 0xFFFFFF00u + reason;
    gl_Position = vec4(0.0);
}
