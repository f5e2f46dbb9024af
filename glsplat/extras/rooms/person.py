"""Person: a participant of a room with recent pose samples. Times are seconds, passed in.

Late tracking is extrapolated for a moment and then held; a person who is silent for longer fades.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError, PoseError
from glsplat.net.codec.body import Placement, pack_body, placement_of
from glsplat.net.room_view import driven_by
from glsplat.rotations import slerp, turn_between
from glsplat.scene import similarity
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton

MAX_AHEAD_S = 0.1
"""Longest extrapolation of a pose."""
SILENT_S = 2.0
"""Silence after which a person fades ..."""
FADE_S = 0.5
"""... and the time that the fading takes."""

_SPEED_SPAN_S = 0.05  # least time between the two samples that speed is measured from, if available
_MAX_TURN = 0.5  # radians that extrapolation turns a joint
_MAX_STEP_M = 0.3  # that extrapolation moves the root


@dataclass(frozen=True, slots=True, eq=False)
class PoseSample:
    """A pose of a person, with its arrival."""

    pose: Pose  # in the avatar's space
    at: float  # seconds of arrival
    t: float | None = None  # milliseconds of the client's clock
    frame_id: int | None = None
    scale: float = 1.0  # user metres = avatar metres * scale
    floor: float = 0.0  # y of the user's floor in metres


class Person:
    """One person. ``seat`` is room from user [4, 4], ``resume`` the token that brings the person back."""

    def __init__(
        self,
        key: int,
        name: str,
        avatar: str,
        seat: NDArray[np.float64],
        resume: str,
        now: float,
        notice: str = "",
        skeleton: Skeleton | None = None,
    ) -> None:
        self.key, self.name, self.avatar, self.seat, self.resume, self.notice = key, name, avatar, seat, resume, notice
        self.connected = True
        self.face: NDArray[np.float64] | None = None  # [3] between the eyes, in the room
        self._skeleton = skeleton
        self._last_seen = now
        self._samples: deque[PoseSample] = deque(maxlen=32)
        self._packed: tuple[bytes, bytes] | None = None  # avatar file's hash, and the last sample on the wire
        self._placed = (1.0, 0.0), (placement_of(seat), seat)  # (scale, floor), and the placement for them
        self.from_room: NDArray[np.float64] = np.asarray(np.linalg.inv(seat), np.float64)  # user from room [4, 4]

    @property
    def own_fields(self) -> dict[str, Any]:
        """``place`` and ``resume`` of the ``room`` in a reply to this person."""
        translation, rotation, _ = placement_of(self.seat)
        return {"place": [round(v, 6) for v in (*translation, *rotation)], "resume": self.resume}

    @property
    def newest(self) -> PoseSample | None:
        """The last sample."""
        return self._samples[-1] if self._samples else None

    def touch(self, now: float) -> None:
        """Record a sign of life."""
        self._last_seen = max(self._last_seen, now)

    def head(self, pose: Pose) -> NDArray[np.float64] | None:
        """Return the joint of the head [3] in the avatar's space, else the highest joint; None without a skeleton."""
        skeleton = self._skeleton
        if skeleton is None:
            return None
        places = skeleton.joints
        joint = skeleton.names.index("head") if "head" in skeleton.names else int(places[:, 1].argmax())
        bone: NDArray[np.float64] = pose.bones(skeleton)[joint]
        return bone[:, :3] @ places[joint] + bone[:, 3]

    def set_head(self, head: Sequence[float] | None) -> None:
        """Set the head position of the tracking, in the user's space; None: unknown."""
        self.face = None if head is None else self.seat[:3, :3] @ np.asarray(head[:3]) + self.seat[:3, 3]

    def add_sample(self, sample: PoseSample) -> None:
        """Add a sample. Raises PoseError, and keeps the previous one, for an impossible scale or floor."""
        self.touch(sample.at)
        self.place(sample)
        self._samples.append(sample)
        self._packed = None

    def packed(self, sha256: bytes) -> bytes | None:
        """Return the last sample packed for clients that draw the avatar file ``sha256``; None without a sample."""
        last = self.newest
        if last is None:
            return None
        if self._packed is None or self._packed[0] != sha256:
            body = pack_body(
                *(last.pose, sha256, self.place(last)[0]),
                at=last.at * 1e3,
                t=last.t,
                key=self.key,
                frame_id=last.frame_id or 0,
            )
            self._packed = sha256, body
        return self._packed[1]

    def silence(self, now: float) -> float:
        """Return the seconds since the last sign of life, or since joining."""
        return max(0.0, now - self._last_seen)

    def opacity(self, now: float) -> float:
        """Return the presence weight: 1 while active, decaying to 0 after SILENT_S of silence."""
        return min(1.0, max(0.0, 1 - (self.silence(now) - SILENT_S) / FADE_S))  # faster than NumPy for one value

    def gone(self, now: float) -> bool:
        """Return whether the person disconnected and has faded."""
        return not self.connected and self.silence(now) >= SILENT_S + FADE_S

    def place(self, sample: PoseSample) -> tuple[Placement, NDArray[np.float64]]:
        """Return room from avatar for a sample's scale and floor, as parts and as a matrix [4, 4]. Raises PoseError."""
        size = sample.scale, sample.floor
        if size != self._placed[0]:
            with np.errstate(invalid="ignore"):  # an infinite floor, refused below
                ground = self.seat[:3, 3] + sample.floor * self.seat[:3, 1]
            place = Placement(tuple(ground.tolist()), self._placed[1][0].rotation, sample.scale)
            try:
                self._placed = size, (place, similarity(*place))
            except GlsplatError as error:
                raise PoseError(f"a person cannot be placed at this scale and floor: {error}") from None
        return self._placed[1]

    def extrapolated(self, now: float) -> tuple[Pose, float] | None:
        """Return the pose at ``now`` and the extrapolated seconds; None before the first sample.

        It is the last pose if extrapolation leads to an invalid one.
        """
        last = self.newest
        if last is None:
            return None
        ahead = min(max(0.0, now - last.at), MAX_AHEAD_S)
        before = self._speed_base(last)
        if before is None or ahead == 0:
            return last.pose, 0.0
        try:
            return _extrapolate(before.pose, last.pose, ahead / _seconds_between(before, last)), ahead
        except PoseError:
            return last.pose, 0.0

    def _speed_base(self, last: PoseSample) -> PoseSample | None:
        """Return the sample to measure speed from: far enough back to average noise, near enough to be current."""
        found = None
        for sample in reversed(self._samples):
            seconds = _seconds_between(sample, last)
            if seconds > MAX_AHEAD_S or len(sample.pose.rotations) != len(last.pose.rotations):
                break
            if seconds > 0:
                found = sample
            if seconds >= _SPEED_SPAN_S:
                break
        return found


def _seconds_between(first: PoseSample, second: PoseSample) -> float:
    """Return the seconds between samples, preferably by the client's clock: the network delays samples unevenly."""
    if first.t is not None and second.t is not None:
        return (second.t - first.t) / 1e3
    return second.at - first.at


def _extrapolate(first: Pose, second: Pose, part: float) -> Pose:
    """Return ``second`` moved on by ``part`` of the movement from ``first``; the face stays as it is."""
    angles = np.linalg.norm(turn_between(first.rotations, second.rotations), axis=1)
    parts = np.minimum(part, _MAX_TURN / np.maximum(angles, 1e-12))
    rotations = slerp(first.rotations, second.rotations, 1 + parts)
    step = second.trans - first.trans
    stretch = min(part, _MAX_STEP_M / max(float(np.linalg.norm(step)), 1e-12))
    return Pose(rotations, second.trans + step * stretch, second.translations, second.expression)


def people_fields(
    room: str, viewer: Person, people: Sequence[Person], digests: Mapping[str, bytes | None]
) -> dict[str, Any]:
    """Return ``room`` of a reply in poses: people with hashes of their avatar files, the viewer's seat and token."""
    fields = [
        {"key": one.key, "name": one.name, "avatar": one.avatar, "you": one is viewer}
        | {"label": driven_by([one.name], one.notice)}
        | {"sha256": None if (digest := digests[one.avatar]) is None else digest.hex()}
        for one in people
    ]
    return {"name": room, "people": fields} | viewer.own_fields
