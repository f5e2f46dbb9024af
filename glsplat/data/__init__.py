"""Embedded data: the default avatar and its licence, motions and a recording."""
