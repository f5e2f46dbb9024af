"""The server's renderers, and its tracking solver."""
