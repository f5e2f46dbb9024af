"""Plugins by name, the project's own and entry points of other packages; reconstructors are such plugins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from glsplat.errors import GlsplatError, one_line
from glsplat.extras.authoring.reconstruct.reconstructor import Reconstructor

GROUP = "glsplat.reconstructors"
"""An entry point names a class or function that makes a ``Reconstructor`` without arguments."""
OWN = {
    "builtin": "glsplat.extras.authoring.reconstruct.builtin:Builtin",
    "lhm": "glsplat.extras.authoring.reconstruct.lhm:from_environment",
}
"""These names cannot be taken by other packages."""


@dataclass(frozen=True)
class Plugins:
    """Plugins of one kind. An entry point of ``group`` names a class or function that makes one without arguments."""

    kind: str
    """The noun in messages."""
    group: str
    method: str
    """A method that each must have."""
    own: Mapping[str, str]
    """Name -> "module:attribute" of the project's own; these names cannot be taken by other packages."""

    def names(self) -> tuple[str, ...]:
        """Return all names, the project's own first."""
        return (*self.own, *sorted({entry.name for entry in entry_points(group=self.group)} - set(self.own)))

    def named(self, name: str) -> Any:
        """Load and make the plugin ``name``. Raises GlsplatError, one line, for an unknown name or a failure."""
        entry = self._entry(name)
        try:
            made = entry.load()()
        except GlsplatError:
            raise
        except Exception as error:
            if name in self.own:
                raise
            raise GlsplatError(f'the {self.kind} "{name}" ({entry.value}) does not load: {one_line(error)}') from error
        if not callable(getattr(made, self.method, None)):
            raise GlsplatError(f'the {self.kind} "{name}" ({entry.value}) has no method "{self.method}"')
        return made

    def _entry(self, name: str) -> EntryPoint:
        if name in self.own:
            return EntryPoint(name, self.own[name], self.group)
        found = sorted({entry.value: entry for entry in entry_points(group=self.group, name=name)}.items())
        if not found:
            raise GlsplatError(f'no {self.kind} is called "{name}"; there are {", ".join(self.names())}')
        if len(found) > 1:
            places = ", ".join(value for value, _ in found)
            raise GlsplatError(f'several packages have a {self.kind} "{name}" ({places}); uninstall all but one')
        return found[0][1]


_PLUGINS = Plugins("reconstructor", GROUP, "reconstruct", OWN)


def names() -> tuple[str, ...]:
    """Return the names of all reconstructors, the project's own first."""
    return _PLUGINS.names()


def named(name: str) -> Reconstructor:
    """Load and make a reconstructor. Raises GlsplatError, one line, for an unknown name or a failure."""
    made: Reconstructor = _PLUGINS.named(name)
    return made
