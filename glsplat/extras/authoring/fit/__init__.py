"""The open body fitted to pictures of a person: landmarks, then silhouettes, then clothes as a smooth offset."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
