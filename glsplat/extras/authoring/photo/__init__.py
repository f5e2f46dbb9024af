"""From pictures of a person towards an avatar: the picture files, the person's mask, the check of a capture."""
