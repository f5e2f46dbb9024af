"""Priors of standing people: several poses to start a fit from, and arms relative to the trunk."""
