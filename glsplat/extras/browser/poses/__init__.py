"""Poses over the wire: what a client that draws itself is sent instead of pictures (docs/protocol.md, section 4.1)."""
