// The arena: all splats of a scene in textures of 2^ROW_BITS splats per row, fetched by index. Twin: renderer/arena.py.
// Textures, because the project pass gathers in sorted order, where OpenGL ES and WebGL forbid index buffers.
#if NUMBERED
in uint number;  // replaces gl_VertexID on drivers where it is wrong (Context.vertex_ids)
int splat_index() { return int(number); }
#else
int splat_index() { return gl_VertexID; }
#endif

ivec2 texel_of(int index, int texels) {  // first texel of a splat
    return ivec2((index & ((1 << ROW_BITS) - 1)) * texels, index >> ROW_BITS);
}
