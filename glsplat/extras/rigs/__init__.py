"""Other programs' rigs: the names of their joints, their map to the 55 joints of SMPL-X, and how they are driven."""

REQUIRES = ("formats",)
