"""Measure the server's network side, by hand."""
