"""Rooms: people of one scene, each of whom sees the others from their own eyes."""

REQUIRES = ()
