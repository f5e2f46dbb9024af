"""Meshes in other programs' glTF: surfaces, rigs of any family, and what is left out."""
