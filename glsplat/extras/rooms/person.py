"""Person: somebody in a room, as the samples of their tracking tell. No clock: times are seconds that come in.

Tracking that is late or missing is extrapolated for a moment and then held; who is silent for longer fades.
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
from glsplat.rotations import slerp, turn_between
from glsplat.scene import similarity
from glsplat.skinning.pose import Pose

__all__ = ["AHEAD", "FADE", "SILENT", "Moved", "Person", "people_fields"]

AHEAD = 0.1
"""Seconds that a pose is extrapolated at most."""
SILENT = 2.0
"""Seconds without a sample after which a person fades ..."""
FADE = 0.5
"""... and how many that takes."""

_BASE = 0.05  # seconds between the two samples that tell how fast somebody moves, if there are that many
_FASTEST = 0.5  # radians that extrapolation turns a joint at most
_FARTHEST = 0.3  # metres that it moves the root at most


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """A sample: where somebody is."""

    pose: Pose  # in the avatar's space
    at: float  # seconds, when it came
    t: float | None = None  # milliseconds of the client's clock
    frame_id: int | None = None
    scale: float = 1.0  # user metres = avatar metres * scale
    floor: float = 0.0  # y of the user's floor in metres


class Person:
    """One person. ``seat`` [4, 4] takes the user's space to the room's; ``resume`` is the token to come back with."""

    def __init__(
        self, key: int, name: str, avatar: str, seat: NDArray[np.float64], resume: str, now: float, label: str = ""
    ) -> None:
        self.key, self.name, self.avatar, self.seat, self.resume, self.label = key, name, avatar, seat, resume, label
        self.connected = True
        self.face: NDArray[np.float64] | None = None  # [3] between their eyes, in the room
        self._heard = now
        self._samples: deque[Moved] = deque(maxlen=32)
        self._packed: tuple[bytes, bytes] | None = None  # the newest sample on the wire, by the avatar's hash
        self._placed = (1.0, 0.0), (placement_of(seat), seat)  # scale and floor, and the place at them
        self._to_room = np.asarray(np.linalg.inv(seat), np.float64)

    @property
    def newest(self) -> Moved | None:
        """The last sample."""
        return self._samples[-1] if self._samples else None

    def heard(self, now: float) -> None:
        """Something came from them."""
        self._heard = max(self._heard, now)

    def looked(self, head: Sequence[float] | None) -> None:
        """Where the head of their tracking is, in their own space; None: not told."""
        self.face = None if head is None else self.seat[:3, :3] @ np.asarray(head[:3]) + self.seat[:3, 3]

    def moved(self, sample: Moved) -> None:
        """Take a sample. Raises PoseError, and keeps the last one, where nobody can stand at its scale and floor."""
        self.heard(sample.at)
        self.place(sample)
        self._samples.append(sample)
        self._packed = None

    def packed(self, sha256: bytes) -> bytes | None:
        """The newest sample as it is sent to all who draw the avatar of that file; None before any came."""
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

    def silent(self, now: float) -> float:
        """Seconds since anything came from them, or since they are here."""
        return max(0.0, now - self._heard)

    def opacity(self, now: float) -> float:
        """1 for who is there, falling to 0 for who has been silent for too long."""
        return min(1.0, max(0.0, 1 - (self.silent(now) - SILENT) / FADE))  # not numpy's: it is asked for every body

    def gone(self, now: float) -> bool:
        """Whether nothing is left of them."""
        return not self.connected and self.silent(now) >= SILENT + FADE

    def place(self, sample: Moved) -> tuple[Placement, NDArray[np.float64]]:
        """Return where the user of a sample is, at their size: room from avatar in parts and as a matrix [4, 4].

        Raises PoseError for a scale and floor at which nobody can be drawn.
        """
        size = sample.scale, sample.floor
        if size != self._placed[0]:
            with np.errstate(invalid="ignore"):  # of an infinite floor, which is refused
                ground = self.seat[:3, 3] + sample.floor * self.seat[:3, 1]
            place = Placement(tuple(ground.tolist()), self._placed[1][0].rotation, sample.scale)
            try:
                self._placed = size, (place, similarity(*place))
            except GlsplatError as error:
                raise PoseError(f"nobody can stand at this scale and floor: {error}") from None
        return self._placed[1]

    def from_room(self) -> NDArray[np.float64]:
        """[4, 4] user from room."""
        return self._to_room

    def at(self, now: float) -> tuple[Pose, float] | None:
        """The pose they will have at ``now``, and the seconds of it that are extrapolated; None before any came.

        The last pose where the movement leads beyond what a pose may be.
        """
        last = self.newest
        if last is None:
            return None
        ahead = min(max(0.0, now - last.at), AHEAD)
        before = self._base(last)
        if before is None or ahead == 0:
            return last.pose, 0.0
        try:
            return _ahead(before.pose, last.pose, ahead / _between(before, last)), ahead
        except PoseError:
            return last.pose, 0.0

    def _base(self, last: Moved) -> Moved | None:
        """The sample to measure the speed from: far enough back for noise to count little, near enough to be true."""
        found = None
        for sample in reversed(self._samples):
            seconds = _between(sample, last)
            if seconds > AHEAD or len(sample.pose.rotations) != len(last.pose.rotations):
                break
            if seconds > 0:
                found = sample
            if seconds >= _BASE:
                break
        return found


def _between(first: Moved, second: Moved) -> float:
    """Seconds, by the client's clock where both have it: the network delays samples unevenly."""
    if first.t is not None and second.t is not None:
        return (second.t - first.t) / 1e3
    return second.at - first.at


def _ahead(first: Pose, second: Pose, part: float) -> Pose:
    """The movement from one pose to another, continued by ``part`` of it; the face stays as it is."""
    angles = np.linalg.norm(turn_between(first.rotations, second.rotations), axis=1)
    parts = np.minimum(part, _FASTEST / np.maximum(angles, 1e-12))
    rotations = slerp(first.rotations, second.rotations, 1 + parts)
    step = second.trans - first.trans
    moved = min(part, _FARTHEST / max(float(np.linalg.norm(step)), 1e-12))
    return Pose(rotations, second.trans + step * moved, second.translations, second.expression)


def people_fields(
    room: str, viewer: Person, people: Sequence[Person], digests: Mapping[str, bytes | None]
) -> dict[str, Any]:
    """Return ``room`` of a reply in poses: its people with the SHA-256 of their avatars' files, and the viewer's seat.

    ``resume`` is the token by which the viewer comes back.
    """
    translation, rotation, _ = placement_of(viewer.seat)
    fields = [
        {"key": one.key, "name": one.name, "avatar": one.avatar, "you": one is viewer, "label": one.label}
        | {"sha256": None if (digest := digests[one.avatar]) is None else digest.hex()}
        for one in people
    ]
    return {"name": room, "place": [*translation, *rotation], "people": fields, "resume": viewer.resume}
