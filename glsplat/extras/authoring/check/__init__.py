"""Whether a picture of a person will do: findings about the picture and the posture."""
