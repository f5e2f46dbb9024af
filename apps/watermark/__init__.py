"""glsplat watermark."""
