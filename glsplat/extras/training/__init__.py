"""How the network of ``learned`` is made: clips, what real tracking does to them, and the fit."""

REQUIRES = ("learned", "motions")
