"""Rigs of others: what their joints are called, which of the 55 joints of SMPL-X they are, and how they are driven.

Imports extras/formats for textures of meshes.
"""
