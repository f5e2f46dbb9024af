"""The faces of avatars: shapes from the morph targets of the mesh that an avatar is made of."""
