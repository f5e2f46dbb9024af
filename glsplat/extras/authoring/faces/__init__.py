"""Faces that move: eyeballs, lids, lashes, hair, teeth and the mouth."""
