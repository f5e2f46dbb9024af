"""Head and hands to joint rotations by closed forms: the analytic solver, and what the learned one shares with it."""
