"""The avatar as a browser fetches it: quantised, in parts, the coarsest first (docs/protocol.md, section 8.1)."""
