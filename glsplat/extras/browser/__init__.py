"""Avatars that the page draws by itself: their file, their shaders, poses over the wire."""

REQUIRES = ("formats",)
