"""OpenXR: a native client on the PC that runs the headset (docs/openxr.md). Importing it imports no pyopenxr."""

import lazy_loader

REQUIRES = ("speech",)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
