"""Motion: recorded movement of a skeleton, its readers, and the embedded library."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.motion.motion import Motion, embedded_motions, load_motion

__all__ = ["Motion", "embedded_motions", "load_motion"]

_HOME = {"Motion": "motion", "embedded_motions": "motion", "load_motion": "motion"}

__getattr__ = on_demand(__name__, _HOME)
