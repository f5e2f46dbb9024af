"""The statistics of a user study: aligned rank transform, F tests, contrasts, effect sizes, reliability, power."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
