"""Which pixels of a picture are the person."""
