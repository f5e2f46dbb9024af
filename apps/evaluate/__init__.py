"""``glsplat evaluate``."""
