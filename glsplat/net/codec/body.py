"""A body on the wire: the pose of one person at one moment, packed once however many are sent it, and read back.

Little endian (docs/protocol.md, section 4.1): u16 bytes in all, u16 flags, u32 key, u32 frame_id, f64 at, f64 t, u8
opacity, u8 0, u16 joints, 32 bytes SHA-256, 8 f32 place, 3 f32 trans, joints x 4 i16 rotations, 52 u8 expression where
there is one, and where joints are moved u16 how many and for each u16 joint, 3 f32 translation.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import PoseError, ProtocolError
from glsplat.rotations import quaternion_of, quaternion_vectors, vector_quaternions
from glsplat.scene import similarity
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.pose import Pose

__all__ = [
    "AT_ORIGIN",
    "MAX_BODIES",
    "PersonPose",
    "Placement",
    "PoseHistory",
    "Poses",
    "for_recipient",
    "pack_body",
    "placement_of",
    "unpack_bodies",
]

F64 = NDArray[np.float64]

MAX_BODIES = 255
"""Bodies of one reply."""
YOU, EXPRESSION, TRANSLATIONS = 1, 2, 4
"""Flags."""

_HEAD = struct.Struct("<HHIIddBBH32s8f3f")
_FLAGS, _OPACITY = 2, 28  # offsets
_QUATERNION_UNIT = 32767  # of a number of a quaternion
_MAX_NUMBER = 1e6  # of any other number, as in a pose
_MIN_SCALE = 1e-5  # of a scale
_ARKIT_INDEX = {name: i for i, name in enumerate(ARKIT)}


class Placement(NamedTuple):
    """A similarity in parts."""

    translation: tuple[float, ...]  # [3] metres
    rotation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)  # xyzw
    scale: float = 1.0


AT_ORIGIN = Placement((0.0, 0.0, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class PersonPose:
    """One person at one moment, as a client is told."""

    key: int  # of the person, as long as they are in the room; 0 alone
    you: bool
    frame_id: int  # of the request that the pose comes from, as its driver counts
    at: float  # milliseconds of the server's clock, when that came
    t: float | None  # milliseconds of its driver's clock
    opacity: float  # below 1 for who has been silent
    sha256: str  # of the avatar's file
    place: F64  # [4, 4] room from avatar
    pose: Pose


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """A reply in poses, before it is packed."""

    bodies: list[bytes]  # packed
    room: dict[str, Any] | None = None  # its people, where they have changed


@dataclass(slots=True, eq=False)
class PoseHistory:
    """What one client was sent of its room, so that nothing is sent twice."""

    room: tuple[object, ...] = ()  # version of the room's people, and the digests of their avatars
    change: int = 0  # number of the newest change of a body that was sent


def pack_body(
    pose: Pose,
    sha256: bytes,
    place: Placement,
    *,
    at: float,
    t: float | None,
    key: int = 0,
    frame_id: int = 0,
    opacity: float = 1.0,
    you: bool = False,
) -> bytes:
    """A body. What has no place in it is left out: weights beyond 0 to 1, and those of shapes that ARKit lacks."""
    quats = vector_quaternions(pose.rotations)
    rotations = np.rint(quats[:, (1, 2, 3, 0)] * _QUATERNION_UNIT).astype("<i2")
    flags = YOU * you
    tail = [rotations.tobytes()]
    if pose.expression and (face := _face(pose.expression)) is not None:
        flags |= EXPRESSION
        tail.append(face)
    if pose.translations is not None:
        flags |= TRANSLATIONS
        tail.append(_moved(pose.translations))
    size = _HEAD.size + sum(map(len, tail))
    if size > 65535:
        raise PoseError(f"a pose of {len(quats)} joints is too long for the wire ({size} bytes)")
    head = _HEAD.pack(
        *(size, flags, key, frame_id, at, nan if t is None else t, round(255 * opacity), 0, len(quats), sha256),
        *(*place.translation, *place.rotation, place.scale, *pose.trans.tolist()),
    )
    return b"".join([head, *tail])


def for_recipient(body: bytes, you: bool, opacity: float) -> bytes:
    """The same for one of those who are sent it: is it they, and how much of it is left."""
    byte = round(255 * opacity)
    if not you and body[_OPACITY] == byte:
        return body
    changed = bytearray(body)
    changed[_FLAGS] |= YOU * you
    changed[_OPACITY] = byte
    return bytes(changed)


def placement_of(matrix: F64) -> Placement:
    """The parts of a similarity [4, 4]."""
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    w, x, y, z = quaternion_of(matrix[:3, :3] / (scale or 1.0)).tolist()
    return Placement(tuple(matrix[:3, 3].tolist()), (x, y, z, w), scale)


def unpack_bodies(data: bytes) -> list[PersonPose]:
    """What stands behind the JSON of a reply in poses. Raises ProtocolError for anything that does not add up."""
    if not data:
        raise ProtocolError("expected the number of bodies behind a reply in poses", "bad_reply")
    found, start = [], 1
    for _ in range(data[0]):
        size = int.from_bytes(data[start : start + 2], "little")
        if size < _HEAD.size or start + size > len(data):
            raise ProtocolError(f"expected a body of {size} bytes, found {len(data) - start}", "bad_reply")
        found.append(_unpacked(data[start : start + size]))
        start += size
    if start != len(data):
        raise ProtocolError(f"{len(data) - start} bytes too many behind the bodies", "bad_reply")
    return found


def _unpacked(data: bytes) -> PersonPose:
    _, flags, key, frame_id, at, t, opacity, _, joints, sha, *numbers = _HEAD.unpack_from(data)
    need = _HEAD.size + 8 * joints + (len(ARKIT) if flags & EXPRESSION else 0)
    need += 2 if flags & TRANSLATIONS else 0
    if need > len(data) or not joints:
        raise ProtocolError(f"a body of {joints} joints needs {need} bytes, not {len(data)}", "bad_reply")
    quats = np.frombuffer(data, "<i2", 4 * joints, _HEAD.size).reshape(-1, 4).astype(np.float64)
    lengths = np.linalg.norm(quats, axis=1, keepdims=True)
    offset = _HEAD.size + 8 * joints
    expression = translations = None
    if flags & EXPRESSION:
        expression = np.frombuffer(data, np.uint8, len(ARKIT), offset) / 255
        offset += len(ARKIT)
    if flags & TRANSLATIONS:
        translations = _translations(data, offset, joints)
    if not (isfinite(at) and max(map(abs, numbers)) <= _MAX_NUMBER and numbers[7] >= _MIN_SCALE and lengths.all()):
        raise ProtocolError("a body needs numbers below 1e6, rotations and a scale", "bad_reply")
    turn = numbers[3:7]
    if not 0.9 < np.linalg.norm(turn) < 1.1:
        raise ProtocolError("the place of a body needs a unit quaternion", "bad_reply")
    vectors = quaternion_vectors((quats / lengths)[:, (3, 0, 1, 2)])
    try:
        pose = Pose(vectors, numbers[8:11], translations, expression)
    except PoseError as error:
        raise ProtocolError(f"a body that is no pose: {error}", "bad_reply") from None
    place = similarity(numbers[:3], turn, numbers[7])
    return PersonPose(
        key, bool(flags & YOU), frame_id, at, t if isfinite(t) else None, opacity / 255, sha.hex(), place, pose
    )


_MOVED = np.dtype([("joint", "<u2"), ("metres", "<f4", 3)])


def _moved(translations: F64) -> bytes:
    """Of the joints that are moved at all: a solved body has few."""
    joints = np.flatnonzero(translations.any(axis=1))
    rows = np.empty(len(joints), _MOVED)
    rows["joint"], rows["metres"] = joints, translations[joints]
    return len(joints).to_bytes(2, "little") + rows.tobytes()


def _translations(data: bytes, offset: int, joints: int) -> F64:
    count = int.from_bytes(data[offset : offset + 2], "little")
    if offset + 2 + count * _MOVED.itemsize > len(data):
        raise ProtocolError(f"a body of {count} joints that are moved ends early", "bad_reply")
    rows = np.frombuffer(data, _MOVED, count, offset + 2)
    if rows["joint"].max(initial=0) >= joints:
        raise ProtocolError(f"joint {rows['joint'].max()} of {joints} is moved", "bad_reply")
    out = np.zeros((joints, 3))
    with np.errstate(invalid="ignore"):  # of a NaN, which Pose refuses
        out[rows["joint"]] = rows["metres"]
    return out


def _face(expression: Mapping[str, float]) -> bytes | None:
    """52 bytes; None where nothing of it is ARKit's."""
    out = bytearray(len(ARKIT))
    for name, weight in expression.items():
        at = _ARKIT_INDEX.get(name)
        if at is not None:
            out[at] = round(255 * min(max(weight, 0.0), 1.0))
    return bytes(out) if any(out) else None
