"""Draw and measure the pictures and tables of the docs."""
