"""General numerical tools: threads, functions compiled by numba, and two solvers."""
