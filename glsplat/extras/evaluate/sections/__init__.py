"""Sections of the report: cost of avatars and of unused features."""
