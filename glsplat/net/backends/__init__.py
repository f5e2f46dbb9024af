"""Renderers as the server sees them."""
