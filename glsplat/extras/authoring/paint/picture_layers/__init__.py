"""The layer of the body that each pixel shows: trunk with head and legs, left arm, right arm, or nothing."""
