"""Textured, skinned meshes on the same cameras and poses: the ground truth avatars are measured against."""

from glsplat.mesh.renderer import MeshConfig, MeshRenderer

__all__ = ["MeshConfig", "MeshRenderer"]
