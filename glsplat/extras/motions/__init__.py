"""Motions of other programs: BVH, AMC, AMASS, glTF and VRM animation, and their retargeting."""

REQUIRES = ("formats", "rigs")
