// Copies the float layers to a window: one view, two side by side, or red-cyan; with text. Row 0 of a layer is the top.
uniform sampler2DArray target;
uniform ivec2 window; // pixels
uniform int view_width; // of one view
#if TEXT
uniform sampler2D text; // premultiplied
uniform ivec4 text_box; // left, top, width, height
#endif
#if LIFTED
#include "lift.glsl"
uniform vec3 first_background, second_background; // of the layers
#endif
out vec4 fragment;

vec4 texel(int x, int y, int view) {
    vec4 colour = texelFetch(target, ivec3(x, y, view), 0);
#if LIFTED
    colour = lifted(colour, view == 0 ? first_background : second_background);
#endif
    return colour;
}

vec3 picture(ivec2 pixel) {
#if ANAGLYPH
    // red from the left eye, green and blue from the right
    return vec3(texel(pixel.x, pixel.y, 0).r, texel(pixel.x, pixel.y, 1).gb);
#else
    int view = int(pixel.x >= view_width);
    int x = pixel.x - view * view_width;
    if (x >= view_width) return vec3(0.0); // the last column of an odd width
    return texel(x, pixel.y, view).rgb;
#endif
}

void main() {
    ivec2 pixel = ivec2(int(gl_FragCoord.x), window.y - 1 - int(gl_FragCoord.y)); // windows count rows from below
    vec3 colour = clamp(picture(pixel), 0.0, 1.0);
#if TEXT
    ivec2 at = pixel - text_box.xy;
    if (all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, text_box.zw))) {
        vec4 ink = texelFetch(text, at, 0);
        colour = ink.rgb + colour * (1.0 - ink.a);
    }
#endif
    fragment = vec4(colour, 1.0);
}
