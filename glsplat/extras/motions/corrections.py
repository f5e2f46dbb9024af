"""Corrections of a motion file that a user writes behind its name: FILE#up=z#scale=0.01."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import PoseError
from glsplat.motion.fitted import grounded, turned
from glsplat.motion.motion import Motion
from glsplat.rotations import rotation_between, rotation_matrices
from glsplat.skinning.skeleton import Skeleton

HELP = "up=z, scale=0.01, turn=180, floor=0, sides=swapped, fps=60"
"""An example of every correction."""

_KEYS = ("up", "scale", "turn", "floor", "sides", "fps")
_AXES = {f"{sign}{axis}": k for k, axis in enumerate("xyz") for sign in ("", "-")}


@dataclass(frozen=True)
class Corrections:
    """Corrections in the axes of the uncorrected motion: y up."""

    up: str = "y"  # the axis that is up: x, -x, y, -y, z, -z
    scale: float = 1.0  # of the path, not of the body
    turn: float = 0.0  # of the body about the vertical, not of its path; degrees
    floor: bool = False  # put the feet on the floor; most files are shifted anyway
    swapped: bool = False  # the file's left is right
    fps: float | None = None

    @property
    def world(self) -> F64:
        """Rotation [3, 3] from ``up`` to y."""
        axis = np.eye(3)[_AXES[self.up]] * (-1 if self.up.startswith("-") else 1)
        return np.diag([-1.0, -1.0, 1.0]) if self.up == "-y" else np.asarray(rotation_between(axis, [0.0, 1.0, 0.0]))

    @property
    def about(self) -> F64:
        """Rotation [3, 3] of the body about the vertical."""
        return np.asarray(rotation_matrices([0.0, np.radians(self.turn), 0.0]))

    def applied(self, motion: Motion, skeleton: Skeleton, *, ground: bool = False) -> Motion:
        """Return the corrected motion; ``ground`` puts its feet on the floor even if ``floor`` is not set.

        Raises PoseError for ``swapped``, which only skeletons of other makers need.
        """
        if self.swapped:
            raise PoseError("sides=swapped is for skeletons of other makers, not for poses by SMPL-X's joints")
        rotations, trans = motion.rotations, motion.trans
        if self.up != "y":
            rotations, trans = turned(rotations, trans, self.world, skeleton)
        if self.turn:
            rotations, _ = turned(rotations, trans, self.about, skeleton)
        trans = trans * self.scale
        if ground or self.floor or self.up != "y":  # along another axis the height of the floor is not known
            trans = grounded(rotations, trans, skeleton)
        known_up = motion.known_up or self.up != "y"
        return replace(motion, rotations=rotations, trans=trans, fps=self.fps or motion.fps, known_up=known_up)


def split_corrections(choice: str | None) -> tuple[str | None, Corrections]:
    """Split the text behind a motion's "#" into an animation's name, or None, and corrections.

    Raises PoseError, one line.
    """
    rest: list[str] = []
    said: dict[str, str] = {}
    for part in (choice or "").split("#"):
        key, equals, value = part.partition("=")
        if equals and key in _KEYS:
            said[key] = value
        else:
            rest.append(part)
    name = "#".join(rest) if choice is not None and (rest or not said) else None
    return name, _read(said)


def _read(said: dict[str, str]) -> Corrections:
    up, sides, floor = said.get("up", "y"), said.get("sides", ""), said.get("floor", "")
    if up not in _AXES:
        raise PoseError(f"up= is one of {', '.join(_AXES)}, not {up[:20]!r}")
    if sides not in ("", "swapped"):
        raise PoseError(f"sides= is swapped, not {sides[:20]!r}")
    if floor not in ("", "0"):
        raise PoseError(f"floor= is 0: the feet stand on it; not {floor[:20]!r}")
    scale = _number(said, "scale", 1.0, 1e-6, 1e6)
    turn = _number(said, "turn", 0.0, -360.0, 360.0)
    fps = _number(said, "fps", 0.0, 1e-3, 1e5) if "fps" in said else None
    return Corrections(up, scale, turn, bool(floor), bool(sides), fps)


def _number(said: dict[str, str], key: str, default: float, least: float, most: float) -> float:
    try:
        value = float(said.get(key, default))
    except ValueError:
        value = np.nan
    if not least <= value <= most:
        raise PoseError(f"{key}= is a number from {least:g} to {most:g}, not {said[key][:20]!r}")
    return value
