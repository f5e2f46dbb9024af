"""Streaming over slow or lossy links: estimation of the link, video, pictures by datagrams."""

REQUIRES = ("operations",)
