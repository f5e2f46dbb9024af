"""Make embedded data."""
