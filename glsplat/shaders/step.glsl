// Default of the caller's post-processing step, applied to a pixel before rounding (renderer/resolve.py): no change.
vec4 stepped(vec4 colour, ivec2 pixel) {
    return colour;
}
