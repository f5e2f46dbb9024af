"""Avatars that clients have made of their photographs, where the server allows it (docs/protocol.md, section 9)."""

REQUIRES = ()
