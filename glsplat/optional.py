"""Look up extras and optional packages by name: the core imports neither, so that each may be missing."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from glsplat.errors import GlsplatError

__all__ = [
    "MissingPackageError",
    "absent_extra",
    "extra_module",
    "has_extra",
    "has_package",
    "missing",
    "missing_package",
    "plugin",
    "require_package",
]


class MissingPackageError(GlsplatError, ImportError):
    """A package of one of glsplat's pip extras is not installed; the message has the command."""


def has_package(name: str) -> bool:
    """Return whether a Python package is installed, without importing it."""
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:  # of its parent
        return False


def missing_package(what: str, package: str, extra: str) -> str:
    """Return the error message for a missing package: ``missing_package("video", "av", "video")``."""
    return f"{what} needs {package}: pip install 'glsplat[{extra}]'"


def require_package(what: str, package: str, extra: str, instead: str = "") -> None:
    """Raise MissingPackageError, which names the pip ``extra``, unless ``package`` is installed.

    ``instead`` is an alternative for the user, such as "leave --video out".
    """
    if not has_package(package):
        raise MissingPackageError(missing_package(what, package, extra) + (f", or {instead}" if instead else ""))


def has_extra(name: str) -> bool:
    """Return whether the folder ``glsplat/extras/NAME`` is installed."""
    return has_package(f"glsplat.extras.{name}")


def extra_module(name: str) -> ModuleType:
    """Return the module ``glsplat.extras.NAME``. Raises ModuleNotFoundError if it is not installed."""
    return import_module(f"glsplat.extras.{name}")


def plugin(name: str) -> ModuleType | None:
    """Return the module ``glsplat.extras.NAME``; None if it, or an extra that it imports, is not installed.

    Other import errors are raised, such as a missing package.
    """
    try:
        return extra_module(name)
    except ModuleNotFoundError as error:
        if absent_extra(error) is None:
            raise
        return None


def absent_extra(error: ModuleNotFoundError) -> str | None:
    """Return the extra whose absence is the cause of ``error``, as ``glsplat.extras.NAME``; None for another cause."""
    parts = (error.name or "").split(".")[:3]
    if parts[:2] != ["glsplat", "extras"] or (len(parts) > 2 and has_extra(parts[2])):
        return None
    return ".".join(parts)


def missing(extra: str, what: str) -> str:
    """Return the error message for a missing extra: ``missing("formats", "SPZ")``."""
    return f"{what} needs glsplat.extras.{extra}, which is not installed"
