"""glsplat tracking."""
