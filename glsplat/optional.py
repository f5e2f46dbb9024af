"""Modules by name. The core looks extras up here and never imports one, so that each folder of extras may be absent."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

__all__ = ["extra_module", "has_extra", "missing", "plugin", "thumbnail"]


def has_extra(name: str) -> bool:
    """Return whether the folder ``glsplat/extras/NAME`` is installed."""
    try:
        return find_spec(f"glsplat.extras.{name}") is not None
    except ModuleNotFoundError:  # no extras at all
        return False


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
        parts = (error.name or "").split(".")
        if parts[:2] != ["glsplat", "extras"] or (len(parts) > 2 and has_extra(parts[2])):
            raise
        return None


def thumbnail(content: object) -> bytes | None:
    """Return a PNG of splats or an avatar for a notebook; None where it cannot be drawn.

    Values stand below the renderer: it is imported when a notebook shows one.
    """
    picture: bytes | None = import_module("glsplat.renderer.thumbnail").thumbnail(content)
    return picture


def missing(extra: str, what: str) -> str:
    """Return the message for something that needs an absent extra: ``missing("formats", "SPZ")``."""
    return f"{what} needs glsplat.extras.{extra}, which is not installed"
