"""glTF 2.0: the container, what nodes show, rigs, and splats, avatars and textured meshes in it."""
