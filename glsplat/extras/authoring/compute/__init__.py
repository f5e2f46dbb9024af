"""Numerical tools that know nothing of people: threads, machine code by numba, two solvers."""
