"""glsplat serve."""
