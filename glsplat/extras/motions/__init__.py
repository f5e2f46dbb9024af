"""Motions of other programs: BVH, AMC, AMASS, glTF and VRM animation, and their retargeting.

Imports extras/rigs (names of joints) and, for AMASS, extras/formats (archives of arrays).
"""
