"""Meshes in glTF as other programs write them: surfaces, rigs of any family, what is left out."""
