"""Frames of a person from all around: read from a video or from pictures, chosen, and which way the person faces."""
