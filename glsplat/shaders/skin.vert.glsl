// Skin pass, once a splat, shared by all views: mean' and M' = R_i M, captured by transform feedback.
#include "frame.glsl"
#include "covariance.glsl"
#include "skin.glsl"
#include "rotation.glsl"

in vec4 mean_opacity;
in vec4 quat;
in vec3 scale;

out vec4 posed_mean;  // xyz, opacity
#if KEEP_ROTATION
out vec4 posed_x, posed_y, posed_z;
#else
out vec3 posed_x, posed_y, posed_z;
#endif

void main() {
    Affine b = blended_bones();
    vec4 mean = vec4(mean_opacity.xyz, 1.0);
    posed_mean = vec4(dot(b.x, mean), dot(b.y, mean), dot(b.z, mean), mean_opacity.w);
    mat3 linear = transpose(mat3(b.x.xyz, b.y.xyz, b.z.xyz));
#if !RAW || KEEP_ROTATION
    Affine a = anchor_bone();
    mat3 anchor = transpose(mat3(a.x.xyz, a.y.xyz, a.z.xyz));
    vec4 turned = blended_quaternion(linear, anchor, frame.knobs.z);
#endif
#if !RAW
    linear = quaternion_matrix(turned);
#endif
    mat3 shape = linear * shape_matrix(quat, scale);
#if KEEP_ROTATION
    vec3 rodrigues = turned.yzw / (1.0 + turned.x);  // modified Rodrigues parameters: no bad case for w >= 0
    posed_x = vec4(shape[0], rodrigues.x);
    posed_y = vec4(shape[1], rodrigues.y);
    posed_z = vec4(shape[2], rodrigues.z);
#else
    posed_x = shape[0];
    posed_y = shape[1];
    posed_z = shape[2];
#endif
    gl_Position = vec4(0.0);
}
