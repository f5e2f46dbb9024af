"""Measurements of the server's network side, by hand."""
