"""Encodings: JPEG, depth grids, and poses."""
