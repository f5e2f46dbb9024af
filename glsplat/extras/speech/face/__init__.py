"""Faces tracked by another program on this machine and sent as OSC over UDP (docs/speech.md)."""
