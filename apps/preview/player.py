"""What pose the preview shows: a motion on its own clock or a still pose, with single joints turned by hand."""

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

__all__ = ["Others", "Player", "Tracked", "players_of"]


@dataclass(frozen=True, eq=False)
class Tracked(Motion):
    """A recording on the player's clock, for a server that solves its samples: the poses here stay zero."""

    samples: Sequence[Mapping[str, Any]] = ()  # tracking objects of docs/protocol.md, one a frame


class Others:
    """The motions of a scene file, but for the one that the player took over."""

    def __init__(self, file: SceneFile | None = None, own: Item | None = None) -> None:
        motions = () if file is None else file.motions.values()
        self._motions = [(item, motion) for item, motion in motions if item is not own]
        self._time = 0.0
        self.playing = bool(self._motions)

    @property
    def moving(self) -> bool:
        """True while the scene changes by itself."""
        return self.playing

    def toggle(self) -> None:
        """Start or stop the clock."""
        self.playing = bool(self._motions) and not self.playing

    def advance(self, seconds: float) -> None:
        """Let the clock run, and pose the items."""
        self._time += seconds
        for item, motion in self._motions:
            item.pose = motion.at(self._time)


class Player:
    """The pose of the moment on one skeleton. ``playing`` lets the clock run; turned joints stay turned meanwhile."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.motion: Motion | None = None
        self.playing = False
        self.joint: int | None = None  # the one that turn() turns
        self._still: Pose | None = None
        self._time = 0.0
        self._turns: dict[int, NDArray[np.float64]] = {}  # quaternions wxyz

    @property
    def moving(self) -> bool:
        """True while the pose changes by itself."""
        return self.playing and self.motion is not None and len(self.motion) > 1

    @property
    def idle(self) -> bool:
        """True while there is neither a motion nor a pose."""
        return self.motion is None and self._still is None

    @property
    def frame(self) -> int:
        """Frame of the motion that is shown or was passed last."""
        # the clock is a sum of small steps: a frame that is due in 1e-6 of one has begun
        return 0 if self.motion is None else int(self._time * self.motion.fps + 1e-6) % len(self.motion)

    @property
    def joint_name(self) -> str:
        """Name of the selected joint, or nothing."""
        return "" if self.joint is None else self.skeleton.names[self.joint]

    @property
    def turned(self) -> float:
        """Degrees by which the selected joint is turned."""
        turn = None if self.joint is None else self._turns.get(self.joint)
        return 0.0 if turn is None else float(np.degrees(np.linalg.norm(quaternion_vectors(turn))))

    def play(self, motion: Motion) -> None:
        """Start a motion from its beginning."""
        self.motion, self._still, self._time, self.playing = motion, None, 0.0, True

    def hold(self, pose: Pose | None) -> None:
        """Show one pose (none: the zero pose) and forget the motion."""
        self.motion, self._still, self.playing = None, pose, False

    def advance(self, seconds: float) -> None:
        """Let the clock run if it does; the motion repeats."""
        if self.moving and self.motion is not None:
            self._time = (self._time + seconds) % self.motion.duration

    def step(self, frames: int) -> None:
        """Stop, and go on or back by whole frames."""
        if self.motion is not None:
            self.playing = False
            self._time = (self.frame + frames) % len(self.motion) / self.motion.fps

    def select(self, step: int) -> None:
        """The next or previous joint."""
        count = len(self.skeleton)
        if self.joint is None:
            self.joint = 0 if step > 0 else count - 1
        else:
            self.joint = (self.joint + step) % count

    def turn(self, axis: Sequence[float], degrees: float) -> None:
        """Turn the selected joint about an axis of its own frame (in the zero pose: of the world)."""
        if self.joint is not None:
            delta = vector_quaternions(np.radians(degrees) * np.asarray(axis, np.float64))
            before = self._turns.get(self.joint, np.array([1.0, 0, 0, 0]))
            self._turns[self.joint] = quaternion_product(before, delta)

    def straighten(self) -> None:
        """Undo the turns of the selected joint; of all joints where none is selected."""
        if self.joint is None:
            self._turns.clear()
        else:
            self._turns.pop(self.joint, None)

    def pose(self) -> Pose:
        """Motion or still pose, then the turned joints."""
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
    """A player for the one visible avatar, if there is one, at what the file says of it; and the other motions."""
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
