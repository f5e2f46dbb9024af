"""glsplat report."""
