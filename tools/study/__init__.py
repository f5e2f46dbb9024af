"""Make the reference figures of a study's analysis."""
