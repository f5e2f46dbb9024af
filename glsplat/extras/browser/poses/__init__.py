"""Poses over the wire, for clients that draw avatars themselves (docs/protocol.md, section 4.1)."""
