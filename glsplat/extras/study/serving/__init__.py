"""A study's server: the session of one participant while it runs, its addresses, and what is recorded of it."""
