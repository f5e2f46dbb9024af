"""OpenGL contexts: create them, make them current, and restore the state of a shared one."""
