"""Measuring: truth, differences, scores and timing series. Nothing at run time imports it."""

import lazy_loader

REQUIRES = ("authoring", "formats", "learned", "motions", "rigs", "statistics")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
