"""Reconstructors by name: the project's own, and those of other packages (entry points of ``GROUP``)."""

from __future__ import annotations

from .plugins import Plugins
from .reconstructor import Reconstructor

GROUP = "glsplat.reconstructors"
"""An entry point names a class or function that makes a ``Reconstructor`` without arguments."""

OWN = {
    "builtin": "glsplat.extras.authoring.reconstruct.builtin:Builtin",
    "lhm": "glsplat.extras.authoring.reconstruct.lhm:from_environment",
}
"""These names cannot be taken by other packages."""

_PLUGINS = Plugins("reconstructor", GROUP, "reconstruct", OWN)


def names() -> tuple[str, ...]:
    """Return all names, the project's own first."""
    return _PLUGINS.names()


def named(name: str) -> Reconstructor:
    """Load and make a reconstructor. Raises GlsplatError, one line, for an unknown name or a failure."""
    made: Reconstructor = _PLUGINS.named(name)
    return made
