"""Check photographs: findings about the picture and the posture."""
