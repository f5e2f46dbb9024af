"""GLSL: chunks assembled into programs by a variant, compiled for a context or sent to the page."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
