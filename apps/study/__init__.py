"""glsplat study."""
