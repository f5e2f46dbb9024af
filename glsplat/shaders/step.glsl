// What a step of somebody else's does to a pixel before it is rounded (renderer/resolve.py): nothing, where there is none.
vec4 stepped(vec4 colour, ivec2 pixel) {
    return colour;
}
