// The texture's colour as it is: no light, no gamma. Cut-outs (hair, brows) end where alpha falls below one half; the
// edge is sharpened to a pixel and becomes sample coverage (alpha to coverage) where there are samples.
uniform sampler2D skin_texture;  // rgb premultiplied by alpha, so that mip maps do not mix in what is cut away
uniform float lowest;  // alpha below which nothing is drawn: 0 for no holes, 0.125 with four samples, 0.5 with one

in vec2 surface_uv;
out vec4 fragment;

void main() {
    vec4 texel = texture(skin_texture, surface_uv);
    float alpha = 1.0;
    if (lowest > 0.0) {
        alpha = clamp((texel.a - 0.5) / max(fwidth(texel.a), 1e-3) + 0.5, 0.0, 1.0);
        if (alpha < lowest) discard;
        if (lowest == 0.5) alpha = 1.0;
        texel.rgb /= max(texel.a, 1.0 / 255.0);
    }
    fragment = vec4(texel.rgb, alpha);
}
