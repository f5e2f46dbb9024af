"""Textures of meshes: which surface point each texel shows, and pictures baked of colours that are asked for."""

from .bake import baked

__all__ = ["baked"]
