"""Motion: recorded movement of a skeleton, its readers, and the embedded library."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
