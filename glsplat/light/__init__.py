"""Light on avatars, and the surfaces of splats that it falls on. Values: nothing here draws."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
