"""Geometry of meshes and splats: nearest points, rasterization, visibility, poses, shapes and footprints."""
