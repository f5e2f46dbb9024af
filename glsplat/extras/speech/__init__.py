"""Speech: sound to the weights of a speaking mouth, the same in Python and in the page (docs/speech.md)."""

import lazy_loader

REQUIRES = ()

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
