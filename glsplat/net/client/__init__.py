"""The client's side of the WebSocket: ``Client``, its connection, and what it sends."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
