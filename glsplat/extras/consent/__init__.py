"""Signed consent in avatar files: the person shown, the purpose, the dates and the permitted drivers (docs/consent.md).

`policy.ConsentPolicy` plugs into the server by `ServerConfig.consent`; `glsplat avatar consent` signs files.
"""

import lazy_loader

REQUIRES = ()

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
