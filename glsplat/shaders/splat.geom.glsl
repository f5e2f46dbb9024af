// Routes layers where the vertex shader cannot write gl_Layer.
layout(triangles) in;
layout(triangle_strip, max_vertices = 3) out;

flat in vec4 vertex_colour[];
in vec2 vertex_offset[];
flat in int vertex_layer[];
flat out vec4 splat_colour;
out vec2 splat_offset;
#if DEPTH || OCCLUDED
flat in float vertex_z[];
flat out float splat_z;
#endif
#if OCCLUDED
flat out int splat_layer;
#endif

void main() {
    for (int i = 0; i < 3; ++i) {
        gl_Layer = vertex_layer[0];
        splat_colour = vertex_colour[0];
        splat_offset = vertex_offset[i];
#if DEPTH || OCCLUDED
        splat_z = vertex_z[0];
#endif
#if OCCLUDED
        splat_layer = vertex_layer[0];
#endif
        gl_Position = gl_in[i].gl_Position;
        EmitVertex();
    }
    EndPrimitive();
}
