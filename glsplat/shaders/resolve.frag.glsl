// Float target to 8 bit, colours as they are (no gamma): the fixed-point target rounds after this clamp.
// The views lie one below the other: rows [v H, (v + 1) H) of the 8-bit target are layer v.
uniform sampler2DArray target;
out vec4 fragment;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    int height = textureSize(target, 0).y;
    int layer = pixel.y / height;
    fragment = clamp(texelFetch(target, ivec3(pixel.x, pixel.y - layer * height, layer), 0), 0.0, 1.0);
}
