"""People as they stand: several poses to begin a fit from, and arms apart from the trunk."""
