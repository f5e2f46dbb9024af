"""Scheduling: whose turn it is, how long pictures take, and the detail that holds a rate."""
