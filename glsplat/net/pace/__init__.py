"""Pace: whose turn it is, how long pictures take, and what detail holds a rate."""
