"""Skeleton, pose, skin (numpy) and the bone texture (GPU)."""
