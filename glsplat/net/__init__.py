"""The network: ``Server`` and ``Client``, and what a renderer or a solver behind them is given. No OpenGL."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
