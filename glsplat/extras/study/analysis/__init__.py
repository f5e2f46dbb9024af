"""The statistics of a user study: aligned rank transform, F tests, contrasts, effect sizes, reliability, power."""

import lazy_loader

from glsplat.optional import require_package

require_package("the analysis of a study", "scipy", "study")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
