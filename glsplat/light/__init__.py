"""Light that falls on avatars, and what splats know of the surface it falls on. Values: nothing here draws."""
