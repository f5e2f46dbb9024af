"""glsplat replay."""
