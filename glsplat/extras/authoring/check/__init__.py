"""The check of photographs: findings about the picture and the posture."""
