"""Compare methods of making avatars over participants: the tables of the paper."""
