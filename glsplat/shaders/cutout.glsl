// What a texel of a mesh shows. Cut-outs (hair, brows) end where alpha falls below one half; the edge is sharpened to a
// pixel and becomes sample coverage (alpha to coverage) where there are samples.

// Where a texture is looked up. A pixel that spans more than all of it (a triangle seen edge on) shows its mean, wherever
// that is taken: llvmpipe visits every texel of an anisotropic footprint, however large, and would not come to an end.
vec2 bounded(vec2 uv, vec2 across, vec2 down) {
    return max(dot(across, across), dot(down, down)) <= 1.0 ? uv : vec2(0.5);
}

// ``texel`` premultiplied, ``change`` of its alpha from pixel to pixel; ``lowest`` alpha that is drawn: 0 for no holes,
// 0.125 with four samples, 0.5 with one. Straight colour and the share that stays; 0: nothing.
vec4 cut_out(vec4 texel, float change, float lowest) {
    if (lowest == 0.0) return vec4(texel.rgb, 1.0);
    float alpha = clamp((texel.a - 0.5) / max(change, 1e-3) + 0.5, 0.0, 1.0);
    if (alpha < lowest) return vec4(0.0);
    return vec4(texel.rgb / max(texel.a, 1.0 / 255.0), lowest == 0.5 ? 1.0 : alpha);
}
