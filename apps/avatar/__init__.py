"""glsplat avatar."""
