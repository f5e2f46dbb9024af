// Cut-outs of a mesh's texture (hair, brows): they end where alpha falls below one half. The edge is sharpened to one
// pixel, and becomes sample coverage (alpha to coverage) under multisampling.

// Return the texture coordinate to sample. A pixel that spans more than the whole texture (a triangle seen edge on)
// shows its mean, so a fixed coordinate will do: llvmpipe visits every texel of the anisotropic footprint.
vec2 bounded(vec2 uv, vec2 across, vec2 down) {
    return max(dot(across, across), dot(down, down)) <= 1.0 ? uv : vec2(0.5);
}

// Return the straight colour and the coverage of a premultiplied ``texel``; 0: a hole. ``change`` of its alpha between
// pixels; ``lowest`` alpha that is drawn: 0 without holes, 0.125 with four samples, 0.5 with one.
vec4 cut_out(vec4 texel, float change, float lowest) {
    if (lowest == 0.0) return vec4(texel.rgb, 1.0);
    float alpha = clamp((texel.a - 0.5) / max(change, 1e-3) + 0.5, 0.0, 1.0);
    if (alpha < lowest) return vec4(0.0);
    return vec4(texel.rgb / max(texel.a, 1.0 / 255.0), lowest == 0.5 ? 1.0 : alpha);
}
