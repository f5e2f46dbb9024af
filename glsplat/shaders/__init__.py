"""GLSL: chunks put together to programs by a variant, compiled for a context or handed to a page."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
