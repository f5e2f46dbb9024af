"""Skeleton, pose, skin (numpy) and the bone texture (GPU)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["JOINT_NAMES"]

_HOME = {"JOINT_NAMES": "smplx"}

__getattr__ = on_demand(__name__, _HOME)
