// Skin pass, once per splat of an avatar: mean' = s (blended bones) mean, M' = s R_i M, by transform feedback.
#include "covariance.glsl"
#include "skin.glsl"
#include "rotation.glsl"
#if SHAPED
#include "shapes.glsl"
#endif

uniform float shift;  // eigenvalue shift of the rotation average: 1 for rigid bones, 3 if one scales or reflects
uniform float size;   // s: the item's scale; its rotation and translation are in the bones
uniform float signed_opacity;  // negative if some items request opacity compensation, and this one does

in vec4 mean_opacity;
in vec4 quat;
in vec3 scale;

out vec4 posed_mean;  // xyz, opacity
out vec4 posed_x, posed_y, posed_z;  // columns of M'; w: modified Rodrigues parameters of R_i

void main() {
    Affine b = blended_bones();
    vec4 mean = vec4(mean_opacity.xyz, 1.0);
#if SHAPED
    mat3 rest = expressed(mean.xyz, quat, scale);
#else
    mat3 rest = shape_matrix(quat, scale);
#endif
    posed_mean = vec4(size * vec3(dot(b.x, mean), dot(b.y, mean), dot(b.z, mean)), signed_opacity * mean_opacity.w);
    mat3 linear = transpose(mat3(b.x.xyz, b.y.xyz, b.z.xyz));
#if !RAW || TURNED
    Affine a = anchor_bone();
    mat3 anchor = transpose(mat3(a.x.xyz, a.y.xyz, a.z.xyz));
    vec4 turned = blended_quaternion(linear, anchor, shift);
#endif
#if !RAW
    linear = quaternion_matrix(turned);
#endif
    mat3 shape = size * (linear * rest);
#if TURNED
    vec3 rodrigues = turned.yzw / (1.0 + turned.x);  // defined for w >= 0
#else
    vec3 rodrigues = vec3(0.0);
#endif
    posed_x = vec4(shape[0], rodrigues.x);
    posed_y = vec4(shape[1], rodrigues.y);
    posed_z = vec4(shape[2], rodrigues.z);
    gl_Position = vec4(0.0);
}
