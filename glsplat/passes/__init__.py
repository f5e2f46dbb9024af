"""The passes of a frame: skin, key, sort, project, draw, resolve. Each owns its GL objects and has release()."""
