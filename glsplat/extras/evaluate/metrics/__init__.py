"""Measures of the difference of two pictures [H, W, 3] in [0, 1]."""
