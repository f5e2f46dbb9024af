"""Training of the network of ``learned``: clips, tracking errors, and the fit."""

REQUIRES = ("learned", "motions")
