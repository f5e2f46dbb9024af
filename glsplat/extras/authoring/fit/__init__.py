"""Fit the open body to pictures of a person: to landmarks, then to silhouettes, then clothes as smooth offsets."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
