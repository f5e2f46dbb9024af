// Copies the float layers to a headset's images, an instance per eye, without filtering; row 0 is the bottom there.
// ROOM adds the frame and glass of a mirror, and a floor. Twin of the planes: extras/openxr/placing.py.
uniform sampler2DArray target;
uniform int first;  // the eye of the first instance
uniform int rows;   // pixels of an image
uniform vec3 corner;  // in a window: corner of the picture, and picture pixels per window pixel; else 0, 0, 1
#if LIFTED
#include "lift.glsl"
uniform vec3 first_background, second_background;
#endif
#if LINEAR
#include "srgb.glsl"
#endif
#if DEPTH
uniform sampler2DArray depth_sum;
uniform vec3 depth_range;  // near and far in metres, metres a unit of the sum
#endif
#if ROOM
uniform mat3 glass_from_pixel[2];  // metres on the mirror's plane, homogeneous; z > 0 where the eye looks at it
uniform mat3 floor_from_pixel[2];
uniform vec4 glass;  // metres: half width, bottom, top, width of the frame; half width 0: no mirror
uniform vec3 extent;  // floor: half its side and the fade distance in metres; 1 if there is a floor, else 0
uniform vec2 eye[2];  // x and z on the floor
const vec3 FRAME = vec3(0.45, 0.36, 0.22), LINES = vec3(0.22, 0.26, 0.33);
const float THICK = 0.006;  // half the width of a line in metres
#endif
flat in int layer;
out vec4 fragment;

#if ROOM
float grid(vec2 at, vec2 seen) {  // coverage of lines a metre apart, at least a pixel wide
    vec2 off = abs(at - round(at)), wide = max(vec2(THICK), 0.5 * seen);
    vec2 cover = clamp((wide - off) / seen + 0.5, 0.0, 1.0) * THICK / wide;
    return max(cover.x, cover.y);
}

vec4 placed(vec4 picture, vec3 pixel, int view) {
    vec3 plane = floor_from_pixel[view] * pixel;
    vec2 at = plane.xy / plane.z, seen = max(fwidth(at), vec2(1e-6));
    float fade = clamp(1.0 - distance(at, eye[view]) / extent.y, 0.0, 1.0);
    bool on = extent.z > 0.0 && plane.z > 0.0 && all(lessThanEqual(abs(at), vec2(extent.x)));
    vec4 around = on ? vec4(LINES, 1.0) * grid(at, seen) * fade : vec4(0.0);
    if (glass.x == 0.0) return picture + (1.0 - picture.a) * around;
    vec3 mirror = glass_from_pixel[view] * pixel;
    if (mirror.z <= 0.0) return around;
    vec2 spot = mirror.xy / mirror.z, middle = vec2(0.0, 0.5 * (glass.y + glass.z));
    vec2 beyond = abs(spot - middle) - vec2(glass.x, 0.5 * (glass.z - glass.y));
    float most = max(beyond.x, beyond.y);
    if (most <= 0.0) return vec4(picture.rgb, 1.0);  // the glass is black behind people
    return most <= glass.w ? vec4(FRAME, 1.0) : around;
}
#endif

void main() {
    int view = first + layer;
    ivec2 at = ivec2((gl_FragCoord.xy - corner.xy) * corner.z);
    ivec3 texel = ivec3(at.x, rows - 1 - at.y, view);
    vec4 colour = texelFetch(target, texel, 0);
#if DEPTH
    vec2 sums = texelFetch(depth_sum, texel, 0).rg;
    float z = sums.r * depth_range.z / sums.g;
    float deep = (1.0 - depth_range.x / z) * depth_range.y / (depth_range.y - depth_range.x);
    gl_FragDepth = sums.g > 0.0 ? clamp(deep, 0.0, 1.0) : 1.0;
#endif
#if LIFTED
    colour = lifted(colour, view == 0 ? first_background : second_background);
#endif
    colour = clamp(colour, 0.0, 1.0);
#if ROOM
    colour = placed(colour, vec3(vec2(texel.xy) + 0.5, 1.0), view);
#endif
#if LINEAR
    colour.rgb = linear_of(colour.rgb);  // the image has a linear format: runtimes read its bytes as linear light
#endif
    fragment = colour;
}
