// Meshes of a scene, before any splat: skinned like a person mesh, an instance a view, the views one below the other.
#include "frame.glsl"
#include "skin.glsl"

in vec3 vertex;
in vec2 uv;

out vec2 surface_uv;
out float surface_z;  // camera z in metres
flat out int surface_view;
out float gl_ClipDistance[2];  // at the seams between the views

void main() {
    Affine b = blended_bones();
    vec4 p = vec4(vertex, 1.0);
    p = vec4(dot(b.x, p), dot(b.y, p), dot(b.z, p), 1.0);
    View v = frame.views[gl_InstanceID];
    vec3 c = vec3(dot(v.rows[0], p), dot(v.rows[1], p), dot(v.rows[2], p));  // camera axes of OpenCV
    // pixel * 2 / size - 1, times w = z: row 0 of the image is row 0 of the texture, as in splat.vert.glsl
    vec2 pixel = v.intrinsics.xy * c.xy + v.intrinsics.zw * c.z;
    vec2 place = pixel * frame.size.zw - c.z;
    gl_ClipDistance[0] = c.z + place.y;
    gl_ClipDistance[1] = c.z - place.y;
    place.y = (place.y + float(2 * gl_InstanceID + 1 - VIEWS) * c.z) / float(VIEWS);
    gl_Position = vec4(place, c.z - 2.0 * v.range.x, c.z);  // cut at the near plane; depths are the fragments' own
    surface_uv = uv;
    surface_z = c.z;
    surface_view = gl_InstanceID;
}
