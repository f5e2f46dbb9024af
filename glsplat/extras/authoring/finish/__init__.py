"""Levels of detail for splats: merged ones, and the density up to which each may stand in for the finest."""
