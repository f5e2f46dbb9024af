"""Accounts: who may use a server, and what for."""

REQUIRES = ()
