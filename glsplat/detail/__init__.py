"""Levels of detail: what they are chosen by and measured against."""
