"""Legs and their steps: the analytic solver's, and what the learned one shares with it."""
