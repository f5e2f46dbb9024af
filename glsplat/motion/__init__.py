"""Motion: recorded movement of a skeleton, its readers, and the embedded library."""
