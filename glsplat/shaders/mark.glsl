// An invisible mark in the colours of what is drawn. Twin: watermark.mark.marked.
// tile: what the mark has at this pixel, of variance 1; levels: how strong it is on black and on white (1 is full).
vec4 marked(vec4 pixel, float tile, vec2 levels) {
    float luma = min(dot(pixel.rgb, vec3(0.299, 0.587, 0.114)), pixel.a);
    float change = tile * (levels.x * pixel.a + (levels.y - levels.x) * luma);
    return vec4(min(pixel.rgb + change, max(pixel.rgb, pixel.a)), pixel.a);
}
