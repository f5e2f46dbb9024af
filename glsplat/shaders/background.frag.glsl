// Backgrounds that differ from view to view; one shared background is a plain clear instead.
#include "frame.glsl"

flat in int layer;
out vec4 fragment;

void main() {
    fragment = vec4(frame.views[layer].background.rgb, 0.0);
}
