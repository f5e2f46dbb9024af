"""glsplat: animatable 3D Gaussian avatars on plain OpenGL, both eyes in one pass."""
