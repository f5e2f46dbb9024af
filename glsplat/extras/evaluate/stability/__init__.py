"""Extreme inputs with a stated behaviour, each tested."""
