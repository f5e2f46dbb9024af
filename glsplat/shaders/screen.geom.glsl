// Routes layers where the vertex shader cannot write gl_Layer.
layout(triangles) in;
layout(triangle_strip, max_vertices = 3) out;

flat in int vertex_layer[];
flat out int layer;

void main() {
    for (int i = 0; i < 3; ++i) {
        gl_Layer = layer = vertex_layer[0];
        gl_Position = gl_in[i].gl_Position;
        EmitVertex();
    }
    EndPrimitive();
}
