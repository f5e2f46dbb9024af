"""``glsplat users``."""
