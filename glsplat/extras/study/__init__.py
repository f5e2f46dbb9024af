"""User studies: a design in a file, orders, a server that leads a participant through, data on disk, tidy tables."""

REQUIRES = ("statistics",)
