// Float target to 8 bit, colours as they are (no gamma): the fixed-point target rounds after this clamp.
uniform sampler2DArray target;
flat in int layer;
out vec4 fragment;

void main() {
    fragment = clamp(texelFetch(target, ivec3(gl_FragCoord.xy, layer), 0), 0.0, 1.0);
}
