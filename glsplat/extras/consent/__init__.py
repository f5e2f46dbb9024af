"""Consent in avatar files: who is shown, who agreed, for what and until when, who may drive (docs/consent.md)."""

REQUIRES = ()
