"""Streaming: messages, sans-I/O session, JPEG, server and client (docs/protocol.md). Imports no OpenGL."""
