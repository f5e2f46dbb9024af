"""SOG (PlayCanvas, "spatially ordered Gaussians"): a meta.json and WebP images, in a zip or in a folder."""
