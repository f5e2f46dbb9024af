"""The statistics of a user study: aligned rank transform, F tests, contrasts, effect sizes, reliability, power."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.study.analysis.analysis import analyse
    from glsplat.study.analysis.table import read_table

__all__ = ["analyse", "read_table"]

_HOME = {"analyse": "analysis", "read_table": "table"}

__getattr__ = on_demand(__name__, _HOME)
