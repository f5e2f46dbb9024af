"""The preview's pose: a motion on its own clock or a still pose, with joints rotated by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.formats.scene_file import SceneFile
from glsplat.motion.motion import Motion
from glsplat.rotations import quaternion_product, quaternion_vectors, vector_quaternions
from glsplat.scene import Item, is_rigged
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton


@dataclass(frozen=True, eq=False)
class Tracked(Motion):
    """A recording of tracking samples on the player's clock; the server solves them, and the poses here stay zero."""

    samples: Sequence[Mapping[str, Any]] = ()  # tracking objects of docs/protocol.md, one per frame


class Others:
    """The motions of a scene file, except that of the player's item."""

    def __init__(self, file: SceneFile | None = None, own: Item | None = None) -> None:
        motions = () if file is None else file.motions.values()
        self._motions = [(item, motion) for item, motion in motions if item is not own]
        self._time = 0.0
        self.moving = bool(self._motions)  # the clock runs

    def toggle(self) -> None:
        """Start or stop the clock."""
        self.moving = bool(self._motions) and not self.moving

    def advance(self, seconds: float) -> None:
        """Advance the clock, and pose the items."""
        self._time += seconds
        for item, motion in self._motions:
            item.pose = motion.at(self._time)


class Player:
    """The current pose of one skeleton. ``playing`` runs the clock; rotations by hand are kept."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.motion: Motion | None = None
        self.playing = False
        self.joint: int | None = None  # selected for turn()
        self._still: Pose | None = None
        self._time = 0.0
        self._turns: dict[int, NDArray[np.float64]] = {}  # quaternions wxyz

    @property
    def moving(self) -> bool:
        """Whether the pose changes over time."""
        return self.playing and self.motion is not None and len(self.motion) > 1

    @property
    def idle(self) -> bool:
        """Whether there is neither a motion nor a pose."""
        return self.motion is None and self._still is None

    @property
    def frame(self) -> int:
        """Index of the motion's current frame."""
        # the clock is a sum of small steps: 1e-6 of a frame covers its rounding
        return 0 if self.motion is None else int(self._time * self.motion.fps + 1e-6) % len(self.motion)

    @property
    def joint_name(self) -> str:
        """Name of the selected joint, or \"\"."""
        return "" if self.joint is None else self.skeleton.names[self.joint]

    @property
    def turned(self) -> float:
        """Rotation of the selected joint by hand, in degrees."""
        turn = None if self.joint is None else self._turns.get(self.joint)
        return 0.0 if turn is None else float(np.degrees(np.linalg.norm(quaternion_vectors(turn))))

    def play(self, motion: Motion) -> None:
        """Start a motion from its beginning."""
        self.motion, self._still, self._time, self.playing = motion, None, 0.0, True

    def hold(self, pose: Pose | None) -> None:
        """Show one pose (None: the zero pose) and drop the motion."""
        self.motion, self._still, self.playing = None, pose, False

    def advance(self, seconds: float) -> None:
        """Advance the clock while playing; the motion repeats."""
        if self.moving and self.motion is not None:
            self._time = (self._time + seconds) % self.motion.duration

    def step(self, frames: int) -> None:
        """Pause, and step by whole frames."""
        if self.motion is not None:
            self.playing = False
            self._time = (self.frame + frames) % len(self.motion) / self.motion.fps

    def select(self, step: int) -> None:
        """Select the next (1) or previous (-1) joint."""
        count = len(self.skeleton)
        if self.joint is None:
            self.joint = 0 if step > 0 else count - 1
        else:
            self.joint = (self.joint + step) % count

    def turn(self, axis: Sequence[float], degrees: float) -> None:
        """Rotate the selected joint about an axis of its own frame."""
        if self.joint is not None:
            delta = vector_quaternions(np.radians(degrees) * np.asarray(axis, np.float64))
            before = self._turns.get(self.joint, np.array([1.0, 0, 0, 0]))
            self._turns[self.joint] = quaternion_product(before, delta)

    def straighten(self) -> None:
        """Undo the rotations by hand of the selected joint, or of all joints if none is selected."""
        if self.joint is None:
            self._turns.clear()
        else:
            self._turns.pop(self.joint, None)

    def pose(self) -> Pose:
        """Return the motion's or still pose with the rotations by hand."""
        if self.motion is not None:
            pose = self.motion.at(self._time)
        else:
            pose = self._still or Pose.zero(len(self.skeleton))
        if not self._turns:
            return pose
        rotations: NDArray[np.float64] = pose.rotations.copy()
        for joint, turn in self._turns.items():
            rotations[joint] = quaternion_vectors(quaternion_product(vector_quaternions(rotations[joint]), turn))
        return Pose(rotations, pose.trans, pose.translations, pose.expression)


def players_of(file: SceneFile) -> tuple[Player | None, Others]:
    """Return a player of the single visible avatar (or None) with its pose or motion, and the other motions."""
    item = file.avatar
    if item is None or not is_rigged(item.content):
        return None, Others(file)
    player = Player(item.content.skeleton)
    motion = next((motion for other, motion in file.motions.values() if other is item), None)
    if motion is not None:
        player.play(motion)
    elif item.pose is not None:
        player.hold(item.pose)
    return player, Others(file, item)
