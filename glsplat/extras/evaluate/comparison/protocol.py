"""The protocol of a comparison: tasks, views, sizes and measures (docs/evaluation.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from glsplat.arrays import F64
from glsplat.camera import PAPER_IPD, Camera, look_at, pinhole, stereo_cameras
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.comparison.performance import TASKS

VIEWS: Mapping[str, float] = {"front": 0.0, "left": 90.0, "back": 180.0, "right": 270.0}
"""Azimuth of the camera in degrees by the visible side of the person, growing towards the left hand."""

_DISTANCE = 3.0  # metres from the middle of the figure
LIGHTS = ("none", "capture")
EXTRA_MEASURES = ("flip", "lpips-vgg")
"""Optional measures; they cost more than all others together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """Settings that are the same for all methods. Raises GlsplatError for invalid ones."""

    tasks: tuple[str, ...] = tuple(TASKS)
    motion: str | None = None  # a motion file or name instead of the tasks; ``moments`` of it are drawn
    motion_digest: str = ""  # of the motion file
    moments: int = 8
    views: tuple[str, ...] = tuple(VIEWS)
    size: int = 512  # side of an eye's picture in pixels
    fill: float = 0.88  # share of the picture that the figure takes, in its longer direction
    ipd: float = PAPER_IPD  # metres between the eyes
    light: str = "none"  # of the truth: "none", its textures' own colours; "capture", as in the photograph
    extra_measures: tuple[str, ...] = ()  # measures beyond those of the paper

    def __post_init__(self) -> None:
        if not 64 <= self.size <= 2048:
            raise GlsplatError(f"pictures need 64 to 2048 pixels a side, not {self.size}")
        if self.light not in LIGHTS:
            raise GlsplatError(f"the light is one of {', '.join(LIGHTS)}, not {self.light!r:.30}")
        for name, known in (("tasks", TASKS), ("views", VIEWS)):
            wrong = [word for word in getattr(self, name) if word not in known]
            if wrong or not getattr(self, name):
                raise GlsplatError(f"{name} are some of {', '.join(known)}, not {wrong[0] if wrong else 'none'!r:.40}")
        if strange := set(self.extra_measures) - set(EXTRA_MEASURES):
            raise GlsplatError(f"further measures are {', '.join(EXTRA_MEASURES)}, not {min(strange)!r:.30}")
        if not 1 <= self.moments <= 100:
            raise GlsplatError(f"a motion needs 1 to 100 moments, not {self.moments}")

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object, which is equal for equal protocols."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def eyes(points: F64, view: str, protocol: Protocol) -> tuple[Camera, Camera]:
    """Return both eyes' cameras before the figure ``points`` [N, 3] (metres), level with its middle, on black."""
    centre = (points.max(axis=0) + points.min(axis=0)) / 2
    turn = np.radians(VIEWS[view])
    viewmat = look_at(centre + _DISTANCE * np.array([np.sin(turn), 0, np.cos(turn)]), centre)
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    half = np.abs(seen[:, :2] / np.maximum(seen[:, 2:], 0.1)).max() / protocol.fill
    fov = float(2 * np.degrees(np.arctan(min(half, 3.0))))
    head = np.linalg.inv(viewmat) @ np.diag([1.0, -1.0, -1.0, 1.0])  # OpenXR axes: y up, looking along -z
    size = protocol.size
    return stereo_cameras(head, protocol.ipd, K=pinhole(size, size, fov), size=(size, size))
