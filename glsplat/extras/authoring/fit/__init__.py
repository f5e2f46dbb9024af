"""Fit the open body to pictures of a person: to landmarks, then to silhouettes, then clothes as smooth offsets."""
