"""Head and hand tracking to a full-body pose: filter, calibrate, inverse kinematics. Plain numbers and numpy only."""

from __future__ import annotations

from glsplat.tracking.sample import Sample

__all__ = ["Sample"]
