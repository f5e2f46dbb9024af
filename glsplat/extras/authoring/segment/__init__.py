"""Masks: the pixels of a picture that show the person."""
