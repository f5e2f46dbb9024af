// Textured mesh: linear blend skinning from the same bone texture as the splats, one view.
#include "frame.glsl"
#include "skin.glsl"

in vec3 vertex;
in vec2 uv;

out vec2 surface_uv;

void main() {
    Affine b = blended_bones();
    vec4 p = vec4(vertex, 1.0);
    p = vec4(dot(b.x, p), dot(b.y, p), dot(b.z, p), 1.0);
    View v = frame.views[0];
    vec3 c = vec3(dot(v.rows[0], p), dot(v.rows[1], p), dot(v.rows[2], p));  // camera axes of OpenCV
    // pixel * 2 / size - 1, times w = z: row 0 of the image is row 0 of the texture, as in splat.vert.glsl
    vec2 pixel = v.intrinsics.xy * c.xy + v.intrinsics.zw * c.z;
    float near = v.range.x, far = v.range.y;
    gl_Position = vec4(pixel * frame.size.zw - c.z, (c.z * (far + near) - 2.0 * far * near) / (far - near), c.z);
    surface_uv = uv;
}
