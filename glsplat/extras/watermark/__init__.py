"""An invisible watermark in pictures that identifies the server and the session that received them.

`mark.Watermark` is a step of a renderer's resolve pass; `glsplat serve` adds it, and `glsplat watermark detect` finds
it in leaked pictures (docs/watermark.md).
"""

import lazy_loader

REQUIRES = ()

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
