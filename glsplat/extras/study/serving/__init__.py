"""Serve a study: the running session of one participant, its routes, and recordings."""
