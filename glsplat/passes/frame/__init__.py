"""The passes of a frame, over the whole arena: key, sort, project, draw."""
