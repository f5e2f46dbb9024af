"""Textured, skinned meshes on the same cameras and poses: the ground truth avatars are measured against."""

from glsplat.extras.evaluate.mesh.renderer import MeshConfig, MeshRenderer

__all__ = ["MeshConfig", "MeshRenderer"]
