"""Small statistics that several rooms need: ranks, the signed-rank test, corrections for several tests, bootstrap."""

from glsplat.optional import require_package

REQUIRES = ()

require_package("a statistical test", "scipy", "study")
