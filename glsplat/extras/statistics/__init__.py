"""Statistics shared by several extras: ranks, the signed-rank test, corrections for multiple tests, bootstrap."""

from glsplat.optional import require_package

REQUIRES = ()

require_package("a statistical test", "scipy", "study")
