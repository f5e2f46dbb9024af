"""The fitted body as a mesh, and skirts."""
