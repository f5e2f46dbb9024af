"""Reconstructors by name: the project's own, and those of other packages (entry points of ``GROUP``)."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

from glsplat.errors import GlsplatError

from .reconstructor import Reconstructor

__all__ = ["GROUP", "OWN", "named", "names", "one_line"]

GROUP = "glsplat.reconstructors"
"""An entry point names a class or function that gives a ``Reconstructor`` when it is called without arguments."""

OWN = {
    "builtin": "glsplat.making.reconstruct.builtin:Builtin",
    "lhm": "glsplat.making.reconstruct.lhm:from_environment",
}
"""These names cannot be taken by other packages."""


def names() -> tuple[str, ...]:
    """All that ``named`` knows, the project's own first."""
    return (*OWN, *sorted({entry.name for entry in entry_points(group=GROUP)} - set(OWN)))


def named(name: str) -> Reconstructor:
    """Load and make a reconstructor. Raises GlsplatError, one line, where there is none or it does not load."""
    entry = _entry(name)
    try:
        made = entry.load()()
    except GlsplatError:
        raise
    except Exception as error:
        if name in OWN:
            raise
        raise GlsplatError(f'the reconstructor "{name}" ({entry.value}) does not load: {one_line(error)}') from error
    if not callable(getattr(made, "reconstruct", None)):
        raise GlsplatError(f'the reconstructor "{name}" ({entry.value}) has no method "reconstruct"')
    return made


def one_line(error: Exception) -> str:
    """What somebody else's exception says, short enough for one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


def _entry(name: str) -> EntryPoint:
    if name in OWN:
        return EntryPoint(name, OWN[name], GROUP)
    found = sorted({entry.value: entry for entry in entry_points(group=GROUP, name=name)}.items())
    if not found:
        raise GlsplatError(f'no reconstructor is called "{name}"; there are {", ".join(names())}')
    if len(found) > 1:
        places = ", ".join(value for value, _ in found)
        raise GlsplatError(f'several packages have a reconstructor "{name}" ({places}); uninstall all but one')
    return found[0][1]
