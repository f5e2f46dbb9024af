// A vertex of a textured mesh in one view, skinned by the same bone texture as splats.
#include "frame.glsl"
#include "skin.glsl"

in vec3 vertex;
in vec2 uv;

vec3 camera_point() {  // camera axes of OpenCV
    Affine b = blended_bones();
    vec4 p = vec4(vertex, 1.0);
    p = vec4(dot(b.x, p), dot(b.y, p), dot(b.z, p), 1.0);
    View v = frame.views[0];
    return vec3(dot(v.rows[0], p), dot(v.rows[1], p), dot(v.rows[2], p));
}

vec2 image_place(vec3 c) {
    // pixel * 2 / size - 1, times w = z: row 0 of the image is row 0 of the texture, as in splat.vert.glsl
    vec4 intrinsics = frame.views[0].intrinsics;
    return (intrinsics.xy * c.xy + intrinsics.zw * c.z) * frame.size.zw - c.z;
}

vec4 clip_place(vec3 c) {  // depth from near to far, linear in 1 / z
    float near = frame.views[0].range.x, far = frame.views[0].range.y;
    return vec4(image_place(c), (c.z * (far + near) - 2.0 * far * near) / (far - near), c.z);
}
