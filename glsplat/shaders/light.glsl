// Lighting of splats with a surface: nine coefficients of ambient light and a sun. Twins: reference.shading,
// reference.lit. Direct light reaches an occluded point within a cone about the normal, whose width is its openness.
#include "srgb.glsl"
uniform sampler2D surfaces;  // two texels per splat: normal in the splat's own axes (0: none), occlusion; 1 / shade
uniform vec4 light[11];      // irradiance over pi: coefficients by their monomials, the sun's direction, its colour
const float SOFT = 0.3;      // range of the cosine over which occlusion fades the sun out

vec3 axis(vec3 column) {  // unit, or zero below 1e-15 m, where the direction of a float vector is lost
    float square = dot(column, column);
    return square > 1e-30 ? column * inversesqrt(square) : vec3(0.0);
}

vec3 turned_normal(mat3 shape, vec3 normal) {  // in the scene's axes; the third axis of a flat splat follows from two
    vec3 a = axis(shape[0]), b = axis(shape[1]), c = axis(shape[2]);
    if (a == vec3(0.0)) a = cross(b, c);
    else if (b == vec3(0.0)) b = cross(c, a);
    else if (c == vec3(0.0)) c = cross(a, b);
    vec3 n = normal.x * a + normal.y * b + normal.z * c;
    return n * inversesqrt(max(dot(n, n), 1e-12));
}

vec3 ambient(vec3 n) {
    vec3 sum = light[0].rgb + n.y * light[1].rgb + n.z * light[2].rgb + n.x * light[3].rgb;
    sum += n.x * n.y * light[4].rgb + n.y * n.z * light[5].rgb + (3.0 * n.z * n.z - 1.0) * light[6].rgb;
    return max(sum + n.x * n.z * light[7].rgb + (n.x * n.x - n.y * n.y) * light[8].rgb, 0.0);
}

// Return the factor of a splat's colour in linear light; below zero without a surface.
vec3 shading(int index, mat3 shape) {
    ivec2 at = texel_of(index, 2);
    vec4 surface = texelFetch(surfaces, at, 0);
    if (surface.xyz == vec3(0.0)) return vec3(-1.0);
    vec3 n = turned_normal(shape, surface.xyz);
    float facing = dot(n, light[9].xyz);
    float reached = clamp(1.0 + (facing - sqrt(1.0 - surface.w)) / SOFT, 0.0, 1.0);
    vec3 sum = ambient(n) * surface.w + light[10].rgb * (max(facing, 0.0) * reached);
    return sum * texelFetch(surfaces, at + ivec2(1, 0), 0).rgb;
}

vec3 lit(vec3 colour, vec3 shading) {  // srgb
    return shading.x < 0.0 ? colour : srgb_of(linear_of(colour) * shading);
}
