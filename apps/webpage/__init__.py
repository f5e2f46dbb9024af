"""``glsplat page``."""
