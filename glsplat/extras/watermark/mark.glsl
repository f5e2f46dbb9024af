// An invisible mark in the colours of what is drawn: the step of the resolve pass. Twin: watermark.mark.marked.
// LEVELS (mark.py): how strong it is on black and on white, 1 is full.
uniform sampler2D step_texture;  // the tile, of variance 1, which repeats from the top left pixel of each view on

vec4 marked(vec4 pixel, float tile, vec2 levels) {
    float luma = min(dot(pixel.rgb, vec3(0.299, 0.587, 0.114)), pixel.a);
    float change = tile * (levels.x * pixel.a + (levels.y - levels.x) * luma);
    return vec4(min(pixel.rgb + change, max(pixel.rgb, pixel.a)), pixel.a);
}

vec4 stepped(vec4 colour, ivec2 pixel) {
    return marked(colour, texelFetch(step_texture, pixel % textureSize(step_texture, 0), 0).r, LEVELS);
}
