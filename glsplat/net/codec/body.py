"""The pose of one person on the wire: packed once for all its recipients, and unpacked.

Little endian (docs/protocol.md, section 4.1): u16 bytes in all, u16 flags, u32 key, u32 frame_id, f64 at, f64 t, u8
opacity, u8 0, u16 joints, 32 bytes SHA-256, 8 f32 place, 3 f32 trans, joints x 4 i16 rotations, 52 u8 expression if
there is one, and if joints are translated u16 count and for each of them u16 joint, 3 f32 translation.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import PoseError, ProtocolError
from glsplat.rotations import quaternion_of, quaternion_vectors, vector_quaternions
from glsplat.scene import similarity
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.pose import Pose

MAX_BODIES = 255  # of one reply
YOU, EXPRESSION, TRANSLATIONS = 1, 2, 4
"""Flags."""

_HEAD = struct.Struct("<HHIIddBBH32s8f3f")
_FLAGS, _OPACITY = 2, 28  # offsets
_QUATERNION_UNIT = 32767  # integer that stands for 1 in a quaternion
_MAX_NUMBER = 1e6  # as in a pose
_MIN_SCALE = 1e-5
_ARKIT_INDEX = {name: i for i, name in enumerate(ARKIT)}


class Placement(NamedTuple):
    """A similarity transform: scale, then rotation, then translation."""

    translation: tuple[float, ...]  # [3] metres
    rotation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)  # xyzw
    scale: float = 1.0


AT_ORIGIN = Placement((0.0, 0.0, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class PersonPose:
    """The pose of one person at one moment."""

    key: int  # of the person while in the room; 0 without a room
    you: bool  # the person is the recipient's
    frame_id: int  # of its driver's request
    at: float  # milliseconds of the server's clock, when that request arrived
    t: float | None  # milliseconds of its driver's clock
    opacity: float  # below 1 for a person whose client has been silent
    sha256: str  # of the avatar's file
    place: F64  # [4, 4] room from avatar
    pose: Pose


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """A reply with poses, before it is packed."""

    bodies: list[bytes]  # packed
    room: dict[str, Any] | None = None  # the room's people, if they have changed


@dataclass(slots=True, eq=False)
class PoseHistory:
    """The state of its room that a client was sent last."""

    room: tuple[object, ...] = ()  # version of the room's people, and the digests of their avatars
    change: int = 0  # number of the newest change of a pose that was sent


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
    """Pack a pose. Weights are clipped to 0 to 1; those of shapes that ARKit lacks are dropped. Raises PoseError."""
    quats = vector_quaternions(pose.rotations)
    rotations = np.rint(quats[:, (1, 2, 3, 0)] * _QUATERNION_UNIT).astype("<i2")
    flags = YOU * you
    tail = [rotations.tobytes()]
    if pose.expression and (face := _face(pose.expression)) is not None:
        flags |= EXPRESSION
        tail.append(face)
    if pose.translations is not None:
        flags |= TRANSLATIONS
        tail.append(_packed_translations(pose.translations))
    size = _HEAD.size + sum(map(len, tail))
    if size > 65535:
        raise PoseError(f"a pose of {len(quats)} joints is too long for the wire ({size} bytes)")
    head = _HEAD.pack(
        *(size, flags, key, frame_id, at, nan if t is None else t, round(255 * opacity), 0, len(quats), sha256),
        *(*place.translation, *place.rotation, place.scale, *pose.trans.tolist()),
    )
    return b"".join([head, *tail])


def for_recipient(body: bytes, you: bool, opacity: float) -> bytes:
    """Return a packed pose with the recipient's own fields: whether it is theirs, and its opacity."""
    byte = round(255 * opacity)
    if not you and body[_OPACITY] == byte:
        return body
    changed = bytearray(body)
    changed[_FLAGS] |= YOU * you
    changed[_OPACITY] = byte
    return bytes(changed)


def placement_of(matrix: F64) -> Placement:
    """Return the parts of a similarity [4, 4]."""
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    w, x, y, z = quaternion_of(matrix[:3, :3] / (scale or 1.0)).tolist()
    return Placement(tuple(matrix[:3, 3].tolist()), (x, y, z, w), scale)


def unpack_bodies(data: bytes) -> list[PersonPose]:
    """Unpack the poses behind the JSON object of a reply. Raises ProtocolError."""
    if not data:
        raise ProtocolError("expected the number of bodies in a pose reply", "bad_reply")
    found, start = [], 1
    for _ in range(data[0]):
        size = int.from_bytes(data[start : start + 2], "little")
        if size < _HEAD.size or start + size > len(data):
            raise ProtocolError(f"expected a body of {size} bytes, found {len(data) - start}", "bad_reply")
        found.append(_unpacked(data[start : start + size]))
        start += size
    if start != len(data):
        raise ProtocolError(f"{len(data) - start} extra bytes after the bodies", "bad_reply")
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
        raise ProtocolError(f"a body with an invalid pose: {error}", "bad_reply") from None
    place = similarity(numbers[:3], turn, numbers[7])
    return PersonPose(
        key, bool(flags & YOU), frame_id, at, t if isfinite(t) else None, opacity / 255, sha.hex(), place, pose
    )


_MOVED = np.dtype([("joint", "<u2"), ("metres", "<f4", 3)])


def _packed_translations(translations: F64) -> bytes:
    """Pack the translations that are not zero: a solved pose has few."""
    joints = np.flatnonzero(translations.any(axis=1))
    rows = np.empty(len(joints), _MOVED)
    rows["joint"], rows["metres"] = joints, translations[joints]
    return len(joints).to_bytes(2, "little") + rows.tobytes()


def _translations(data: bytes, offset: int, joints: int) -> F64:
    count = int.from_bytes(data[offset : offset + 2], "little")
    if offset + 2 + count * _MOVED.itemsize > len(data):
        raise ProtocolError(f"a body of {count} moved joints is truncated", "bad_reply")
    rows = np.frombuffer(data, _MOVED, count, offset + 2)
    if rows["joint"].max(initial=0) >= joints:
        raise ProtocolError(f"joint {rows['joint'].max()} of {joints} is moved", "bad_reply")
    out = np.zeros((joints, 3))
    with np.errstate(invalid="ignore"):  # Pose refuses a NaN
        out[rows["joint"]] = rows["metres"]
    return out


def _face(expression: Mapping[str, float]) -> bytes | None:
    """Return 52 bytes; None where no shape is ARKit's."""
    out = bytearray(len(ARKIT))
    for name, weight in expression.items():
        at = _ARKIT_INDEX.get(name)
        if at is not None:
            out[at] = round(255 * min(max(weight, 0.0), 1.0))
    return bytes(out) if any(out) else None
