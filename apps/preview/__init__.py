"""glsplat preview."""
