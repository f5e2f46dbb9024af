// Place pass, once per splat of an item without a skeleton: mean' = s R mean + t, M' = s R M, by transform feedback.
#include "covariance.glsl"
#include "splat_input.glsl"

uniform mat3 turn;           // R
uniform vec3 rodrigues;      // its modified Rodrigues parameters
uniform vec3 offset;         // t, relative to the scene's origin
uniform float size;          // s
uniform float signed_opacity;  // as in skin.vert.glsl

out vec4 posed_mean;
out vec4 posed_x, posed_y, posed_z;

void main() {
    Splat splat = splat_of(splat_index());
    posed_mean = vec4(size * (turn * splat.mean) + offset, signed_opacity * splat.opacity);
    mat3 shape = size * (turn * splat.shape);
    posed_x = vec4(shape[0], rodrigues.x);
    posed_y = vec4(shape[1], rodrigues.y);
    posed_z = vec4(shape[2], rodrigues.z);
    gl_Position = vec4(0.0);
}
