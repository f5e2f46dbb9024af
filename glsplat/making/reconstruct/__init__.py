"""From pictures of a person to an avatar."""
