"""Normals and occlusion of an avatar's splats, and the light that photographs hold already."""
