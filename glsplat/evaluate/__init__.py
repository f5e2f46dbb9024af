"""Measuring: truth, differences, scores and timing series. Nothing at run time imports it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.evaluate.avatar_poses import SCORE_POSES
    from glsplat.evaluate.avatar_score import score

__all__ = ["SCORE_POSES", "score"]

_HOME = {"SCORE_POSES": "avatar_poses", "score": "avatar_score"}

__getattr__ = on_demand(__name__, _HOME)
