"""Pictures to JPEG."""
