"""Measurements: truth, differences, scores and timing series. Run-time code does not import it."""

import lazy_loader

REQUIRES = ("authoring", "formats", "learned", "motions", "rigs", "statistics")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
