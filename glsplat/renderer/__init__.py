"""The renderer: a class for users, a module for each step of a frame, and buffers on the GPU (docs/frame.md)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
