// Key pass: depth as a sortable uint, nearest first, or the reason of culling; and the splat's screen bounds and cost.
#include "frame.glsl"
#include "extent.glsl"
#include "covariance.glsl"
#include "splat_input.glsl"
#include "project.glsl"
#if CULL_HIDDEN
#include "cone.glsl"
#endif

flat out uint key;
// x: bounds in any view, in units of 1/256 of the image: x0, y0, x1, y1, a byte each;
// y: blocks of 4x4 pixels that its bounds cover, summed over the views (renderer/key.py)
flat out uvec2 cover;

void main() {
    Splat splat = splat_of(splat_index());
    gl_Position = vec4(0.0);
#if CULL_HIDDEN
    if (hidden(splat.mean, splat.shape)) {
        key = 0xFFFFFF00u + HIDDEN;
        cover = uvec2(0u);
        return;
    }
#endif
    uint reason = OUTSIDE;
    uint cost = 0u;
    vec2 low = vec2(255.0), high = vec2(0.0);
    for (int v = 0; v < VIEWS; ++v) {
        Footprint foot;
        uint why = project(splat.mean, splat.shape, splat.opacity, v, foot);
        reason = min(reason, why);
        if (why == VISIBLE) {
            vec2 reach = extent_of(foot.alpha) * vec2(foot.cholesky.x, length(foot.cholesky.yz)) + 0.5;
            low = min(low, floor((foot.centre - reach) * frame.size.zw * 128.0));
            high = max(high, floor((foot.centre + reach) * frame.size.zw * 128.0));
            vec2 first = floor(max(foot.centre - reach, 0.0) * 0.25);
            uvec2 blocks = uvec2(ceil(min(foot.centre + reach, frame.size.xy) * 0.25) - first);
            cost += blocks.x * blocks.y;
        }
    }
    uvec4 tiles = uvec4(clamp(vec4(low, high), 0.0, 255.0));
    cover = uvec2(tiles.x | tiles.y << 8 | tiles.z << 16 | tiles.w << 24, cost);
    // with this sign handling IEEE floats compare like integers; codes are above every finite key
    uint bits = floatBitsToUint(dot(frame.sort_row.xyz, splat.mean) + frame.sort_row.w);
    bits = (bits & 0x80000000u) != 0u ? ~bits : bits | 0x80000000u;
    key = reason == VISIBLE ? min(bits, 0xFFFFFEFFu) : 0xFFFFFF00u + reason;
}
