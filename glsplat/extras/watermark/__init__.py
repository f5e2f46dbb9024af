"""An invisible mark in the rendered avatar that leads from a leaked clip to the session that was served it."""

import lazy_loader

REQUIRES = ()

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
