"""OpenGL contexts: making them, taking turns with others, leaving them as they were found."""
