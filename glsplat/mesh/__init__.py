"""Textured, skinned meshes on the same cameras and poses: the ground truth avatars are measured against."""
