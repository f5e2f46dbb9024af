// Box filter of the larger picture of a mesh, over the view's background.
#include "frame.glsl"

uniform sampler2D large;
uniform int factor;  // texels of ``large`` a pixel and axis

flat in int layer;
out vec4 fragment;

void main() {
    ivec2 first = ivec2(gl_FragCoord.xy) * factor;
    vec4 sum = vec4(0.0);
    for (int y = 0; y < factor; ++y)
        for (int x = 0; x < factor; ++x) sum += texelFetch(large, first + ivec2(x, y), 0);
    sum /= float(factor * factor);
    fragment = vec4(sum.rgb + (1.0 - sum.a) * frame.views[layer].background.rgb, sum.a);
}
