"""Speech: mouth shapes from sound, tracked faces, and idle eyes (docs/speech.md).

`glsplat render --speech` and the page move mouths; `serve` takes faces by OSC (`face-osc`) and idle eyes by the plugin
`speech.idle`.
"""

import lazy_loader

REQUIRES = ()

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
