"""Speed: where the time of a frame goes, and what less of it costs."""
