"""The open body that every person is made of: its mesh, its face, the lining of its mouth, its segments."""
