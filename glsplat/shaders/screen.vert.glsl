// One triangle that covers the target, an instance per view, for resolve.frag.glsl and background.frag.glsl.
#if GEOMETRY
flat out int vertex_layer;
#else
flat out int layer;
#endif

void main() {
    gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
#if GEOMETRY
    vertex_layer = gl_InstanceID;
#else
    layer = gl_InstanceID;
#if VIEWS > 1
    gl_Layer = gl_InstanceID;
#endif
#endif
}
