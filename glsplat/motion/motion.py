"""Motion: a sequence of poses at a constant rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import PoseError
from glsplat.rotations import slerp
from glsplat.skinning.expression import mixed
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES

_MAX_ANGLE_RAD = 4 * np.pi  # a larger angle is in degrees


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """T poses at a constant rate for a rig of J joints."""

    fps: float
    rotations: F64  # [T, J, 3] axis-angle, radians
    trans: F64  # [T, 3] metres
    names: tuple[str, ...] = JOINT_NAMES
    label: str = field(default="", compare=False)
    note: str = field(default="", compare=False)
    """Note for the user: which motion of a file this is, and what was left out."""
    known_up: bool = field(default=False, compare=False)
    """Whether the format (as glTF) or the user defines the up axis."""
    expressions: tuple[Mapping[str, float], ...] = ()
    """Weights of an avatar's shapes by name, one mapping per frame; empty: no expressions."""

    def __post_init__(self) -> None:
        frames, joints = len(self.rotations), len(self.names)
        if self.rotations.shape != (frames, joints, 3) or self.trans.shape != (frames, 3):
            raise PoseError(
                f"a motion of {joints} joints needs rotations (T, {joints}, 3) and trans (T, 3), "
                f"not {self.rotations.shape} and {self.trans.shape}"
            )
        if len(self.expressions) not in (0, frames):
            raise PoseError(
                f"a motion of {frames} frames needs as many expressions, or none, not {len(self.expressions)}"
            )
        if not frames:
            raise PoseError("a motion needs at least one frame, found none")
        if not (np.isfinite(self.fps) and 1e-3 <= self.fps <= 1e5):
            raise PoseError(f"a motion needs a frame rate above zero, not {self.fps:g}")
        for value in (self.rotations, self.trans):
            bad = ~np.isfinite(value).reshape(frames, -1).all(axis=1)
            if bad.any():
                raise PoseError(f"frame {int(bad.argmax())} holds NaN or infinity; a motion needs finite numbers")
        angle = np.linalg.norm(self.rotations, axis=2).max(axis=1)
        if angle.max() > _MAX_ANGLE_RAD:
            worst = int(angle.argmax())
            raise PoseError(f"frame {worst} turns a joint by {angle[worst]:.0f} rad; angles are radians, not degrees")

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def duration(self) -> float:
        """Seconds of one loop: frames / fps."""
        return len(self) / self.fps

    def pose(self, frame: int) -> Pose:
        """Return the pose of a frame; negative indices count from the end. Raises PoseError."""
        if not -len(self) <= frame < len(self):
            raise PoseError(f"frame {frame} does not exist; this motion has {len(self)}")
        return Pose(self.rotations[frame], self.trans[frame], expression=self._face(frame % len(self)))

    def _face(self, first: int, second: int = 0, part: float = 0.0) -> Mapping[str, float]:
        """Return the expression of a frame, interpolated towards ``second`` by ``part``."""
        if not self.expressions:
            return {}
        return mixed(self.expressions[first], self.expressions[second], part) if part else self.expressions[first]

    def at(self, seconds: float, loop: bool = True) -> Pose:
        """Return the pose at a time: rotations by slerp, translation linearly. Raises PoseError.

        ``loop`` repeats with the period ``duration``, interpolating from the last frame to the first; otherwise time
        is clamped.
        """
        if not np.isfinite(seconds):
            raise PoseError(f"a time needs to be finite, not {seconds}")
        count = len(self)
        at = seconds * self.fps
        at = at % count if loop else min(max(at, 0.0), count - 1.0)
        first = min(int(at), count - 1)
        second = (first + 1) % count if loop else min(first + 1, count - 1)
        part = min(max(at - first, 0.0), 1.0)
        if part == 0 or first == second:
            return self.pose(first)
        rotations = slerp(self.rotations[first], self.rotations[second], part)
        trans = self.trans[first] * (1 - part) + self.trans[second] * part
        return Pose(rotations, trans, expression=self._face(first, second, part))

    def resampled(self, fps: float) -> Motion:
        """Return the motion at another rate (slerp)."""
        count = max(1, round((len(self) - 1) * fps / self.fps) + 1)
        times = np.minimum(np.arange(count) / fps * self.fps, len(self) - 1)
        if len(self) == 1:
            return Motion(fps, self.rotations, self.trans, self.names, self.label, expressions=self.expressions)
        frames = np.arange(len(self))
        first = np.minimum(times.astype(np.intp), len(self) - 2)
        rotations = slerp(self.rotations[first], self.rotations[first + 1], (times - first)[:, None])
        trans = np.stack([np.interp(times, frames, column) for column in self.trans.T], axis=1)
        parts = zip(first.tolist(), (times - first).tolist(), strict=True) if self.expressions else ()
        faces = tuple(self._face(i, i + 1, part) for i, part in parts)
        return Motion(fps, rotations, trans, self.names, self.label, expressions=faces)
