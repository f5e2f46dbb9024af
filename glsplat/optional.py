"""Extras and optional packages by name: the core imports neither, so that each may be absent."""

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
    "thumbnail",
]


class MissingPackageError(GlsplatError, ImportError):
    """A package that pip installs with one of glsplat's extras is not installed; the message has the command."""


def has_package(name: str) -> bool:
    """Return whether a Python package is installed; it is not imported."""
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:  # its parent is not
        return False


def missing_package(what: str, package: str, extra: str) -> str:
    """Return the message for something that needs an absent package: ``missing_package("video", "av", "video")``."""
    return f"{what} needs {package}: pip install 'glsplat[{extra}]'"


def require_package(what: str, package: str, extra: str, instead: str = "") -> None:
    """Raise MissingPackageError unless ``package`` is installed, with the pip extra that has it.

    ``instead``: what else the user can do, such as "leave --video out".
    """
    if not has_package(package):
        raise MissingPackageError(missing_package(what, package, extra) + (f", or {instead}" if instead else ""))


def has_extra(name: str) -> bool:
    """Return whether the folder ``glsplat/extras/NAME`` is installed."""
    return has_package(f"glsplat.extras.{name}")


def extra_module(name: str) -> ModuleType:
    """Return the module ``glsplat.extras.NAME``. Raises ModuleNotFoundError where its folder is not installed."""
    return import_module(f"glsplat.extras.{name}")


def plugin(name: str) -> ModuleType | None:
    """Return the module ``glsplat.extras.NAME``; None where it, or another extra that it imports, is not installed.

    Any other error of its import is raised: a package that is not installed, a mistake in the module.
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


def thumbnail(content: object) -> bytes | None:
    """Return a PNG of splats or an avatar for a notebook; None where it cannot be drawn.

    Values stand below the renderer: it is imported when a notebook shows one.
    """
    picture: bytes | None = import_module("glsplat.renderer.thumbnail").thumbnail(content)
    return picture


def missing(extra: str, what: str) -> str:
    """Return the message for something that needs an absent extra: ``missing("formats", "SPZ")``."""
    return f"{what} needs glsplat.extras.{extra}, which is not installed"
