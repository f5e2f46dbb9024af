"""Motion: recorded movement of a skeleton, its readers, and the embedded library."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.motion.loading import embedded_motions, load_motion
    from glsplat.motion.motion import Motion

__all__ = ["Motion", "embedded_motions", "load_motion"]

_HOME = {"Motion": "motion", "embedded_motions": "loading", "load_motion": "loading"}

__getattr__ = on_demand(__name__, _HOME)
