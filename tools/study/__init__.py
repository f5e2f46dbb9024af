"""A whole study by scripts."""
