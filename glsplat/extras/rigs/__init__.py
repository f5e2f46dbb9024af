"""Rigs of others: what their joints are called, which of the 55 joints of SMPL-X they are, and how they are driven."""

REQUIRES = ("formats",)
