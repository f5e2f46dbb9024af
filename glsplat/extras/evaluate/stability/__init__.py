"""Stiff and extreme cases: each with its stated behaviour, run and judged."""
