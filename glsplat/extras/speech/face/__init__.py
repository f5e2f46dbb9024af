"""Face tracking that another program on this machine sends, as OSC over UDP (docs/speech.md)."""
