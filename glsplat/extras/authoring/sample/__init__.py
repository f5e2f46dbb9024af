"""Splats that tile the surface of a mesh."""
