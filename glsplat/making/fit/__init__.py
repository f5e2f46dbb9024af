"""The open body fitted to pictures of a person: landmarks, then silhouettes, then clothes as a smooth offset."""
