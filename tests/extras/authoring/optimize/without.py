"""A machine without numba."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest

__all__ = ["without_numba"]


def without_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing finds it any more."""
    find = importlib.util.find_spec

    def found(name: str, package: str | None = None) -> Any:
        return None if name == "numba" else find(name, package)

    monkeypatch.setattr(importlib.util, "find_spec", found)
