"""Small statistics that several rooms need: ranks, the signed-rank test, corrections for several tests, bootstrap."""
