"""The avatar's file for browsers: quantised, in parts, the coarsest first (docs/protocol.md, section 8.1)."""
