"""Longer runs of the attackers and fuzzers of tests/net/attacks."""
