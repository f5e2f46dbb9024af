// Draw pass: a corner of a record's quad (or triangle) in a view, selected by instance, or under PULLED by gl_VertexID.
// gl_Layer routes it to the view's layer of the target.
#include "frame.glsl"
#include "extent.glsl"
#include "record_input.glsl"

#if GEOMETRY
flat out vec4 vertex_colour;
out vec2 vertex_offset;
flat out int vertex_layer;
#if DEPTH || OCCLUDED
flat out float vertex_z;
#endif
#else
flat out vec4 splat_colour;  // rgb, alpha
out vec2 splat_offset;       // standard deviations from the centre
#if DEPTH || OCCLUDED
flat out float splat_z;      // camera z of the mean, in metres
#endif
#if OCCLUDED
flat out int splat_layer;
#endif
#endif

#if ES && VIEWS > 1
uniform int eye;  // the view of this draw: OpenGL ES 3.0 cannot route layers
#endif

void main() {
#if PULLED && TRIANGLE
    int instance = gl_VertexID / 3, number = gl_VertexID % 3;
#elif PULLED
    int instance = gl_VertexID / 6, number = (0x312210 >> 4 * (gl_VertexID % 6)) & 3;  // the triangles of a strip
#else
    int instance = gl_InstanceID, number = gl_VertexID;
#endif
#if ES && VIEWS > 1
    int view = eye;
    Record record = record_of(instance, view);
#else
    int view = instance % VIEWS;
    Record record = record_of(instance / VIEWS, view);
#endif
#if TRIANGLE
    // around the unit circle: 1.3 times the quad's area, but half the primitives, which dominate on a CPU
    vec2 corner = number == 0 ? vec2(0.0, 2.0) : vec2(number == 1 ? -1.7320508 : 1.7320508, -1.0);
#else
    vec2 corner = vec2(number & 1, number >> 1) * 2.0 - 1.0;
#endif
    vec2 offset = corner * extent_of(record.colour.a);
    vec3 l = record.cholesky;
    vec2 pixel = record.centre + vec2(l.x * offset.x, l.y * offset.x + l.z * offset.y);
    // row 0 of the image is row 0 of the texture: no flip is needed later
    gl_Position = vec4(pixel * frame.size.zw - 1.0, 0.0, 1.0);
#if GEOMETRY
    vertex_colour = record.colour;
    vertex_offset = offset;
    vertex_layer = view;
#if DEPTH || OCCLUDED
    vertex_z = record.z;
#endif
#else
    splat_colour = record.colour;
    splat_offset = offset;
#if DEPTH || OCCLUDED
    splat_z = record.z;
#endif
#if OCCLUDED
    splat_layer = view;
#endif
#if VIEWS > 1 && !ES
    gl_Layer = view;
#endif
#endif
}
