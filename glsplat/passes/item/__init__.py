"""The passes of one item of a scene: what it writes into the arena, or onto the ground."""
