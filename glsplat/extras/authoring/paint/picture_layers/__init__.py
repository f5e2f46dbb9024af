"""Which part of the body a pixel shows: trunk with head and legs, left arm, right arm, or nothing of the body."""
