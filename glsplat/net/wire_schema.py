"""The fields of a request as they stand on the wire (docs/protocol.md, section 3): their types, not their limits.

Unknown keys are ignored. Types bound the depth of what is read; messages.py checks the rest, but for tracking, which
becomes a Sample here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot
from typing import TYPE_CHECKING, Any, Literal, TypedDict

import msgspec

from glsplat.errors import FormatError, PoseError, ProtocolError
from glsplat.skinning.expression import checked_expression
from glsplat.tracking.sample import (
    BODY_JOINTS,
    MOST_JOINTS,
    TRACKERS,
    WRISTS,
    Sample,
    grouped,
    hand_joints,
    wrist_from_grip,
)

if TYPE_CHECKING:
    from glsplat.light.light import Light

__all__ = [
    "DEFAULT",
    "FAR",
    "MOST_FACES",
    "NEAR",
    "PICTURE",
    "SH_DEGREE",
    "Alpha",
    "Arrival",
    "Eye",
    "LegacyCamera",
    "LegacyMessage",
    "LightFields",
    "Message",
    "PictureOptions",
    "Place",
    "PoseFields",
    "Tracking",
    "Video",
    "Want",
    "Wishes",
    "faces_of",
    "given",
    "light_of",
    "sample_of",
    "video_of",
]

NEAR, FAR, SH_DEGREE = 0.01, 1e10, 3  # of an eye whose request is silent: Camera's own defaults

Numbers = list[float | list[float]]  # flat or nested once

Expression = dict[str, float] | list[float]  # by name, or in ARKit's order

Joints = tuple[tuple[float, ...], ...]

Place = tuple[float, float, float]

MOST_FACES = 16
"""Faces that a request names at most."""

MOST_CODECS = 8
"""Codecs that a request names at most."""

Alpha = bool | Literal["straight"]
"""Whether alpha is sent too: with colours over black (premultiplied), or with straight ones (codec/straight.py)."""


Want = Literal["picture", "pose"]
"""What is asked for: a picture, or how those stand whom the client draws itself."""


class Eye(msgspec.Struct):
    """A camera: world to camera row by row, and [fx, fy, cx, cy] in pixels."""

    viewmat: list[float]
    K: list[float]
    near: float = NEAR
    far: float = FAR
    sh_degree: int = SH_DEGREE


class Tracking(msgspec.Struct):
    """The fields of glsplat.tracking.sample; null means not tracked."""

    head: tuple[float, ...] | None = None
    left: tuple[float, ...] | None = None
    right: tuple[float, ...] | None = None
    left_grip: tuple[float, ...] | None = None
    right_grip: tuple[float, ...] | None = None
    left_joints: Numbers | None = None
    right_joints: Numbers | None = None
    left_curl: float | None = None
    right_curl: float | None = None
    waist: tuple[float, ...] | None = None
    left_foot: tuple[float, ...] | None = None
    right_foot: tuple[float, ...] | None = None
    body: dict[str, tuple[float, ...] | None] | None = None
    expression: Expression | None = None
    leftEye: tuple[float, ...] | None = None  # noqa: N815 - names of the wire
    rightEye: tuple[float, ...] | None = None  # noqa: N815


class PoseFields(msgspec.Struct):
    """Either layout of glsplat.skinning.pose; other keys are ignored."""

    root_pose: Numbers | None = None
    trans: Numbers | None = None
    body_pose: Numbers | None = None
    jaw_pose: Numbers | None = None
    leye_pose: Numbers | None = None
    reye_pose: Numbers | None = None
    lhand_pose: Numbers | None = None
    rhand_pose: Numbers | None = None
    expression: Expression | None = None
    joints: dict[str, list[float]] | None = None
    translations: dict[str, list[float]] | None = None


class SunFields(msgspec.Struct):
    """A sun or far lamp, as glsplat.light.Light has it."""

    direction: tuple[float, ...]
    color: tuple[float, ...]


class LightFields(msgspec.Struct):
    """What Light.from_json reads: the type bounds the depth, and other keys are dropped as everywhere here."""

    ambient: list[tuple[float, ...]]
    sun: SunFields | None = None


class LegacyCamera(msgspec.Struct):
    """A head pose in Unity's frame."""

    pos_x: float
    pos_y: float
    pos_z: float
    rot_x: float
    rot_y: float
    rot_z: float
    rot_w: float
    eye: Literal["left", "right"] = "left"


class Arrival(msgspec.Struct, frozen=True):
    """What a client says of the picture that ``ack`` names. Milliseconds."""

    age: float  # from when it was asked for until it arrived, or was shown
    held: float = 0.0  # from when it arrived until this message


class Video(msgspec.Struct, frozen=True):
    """That a client can decode video."""

    codecs: tuple[str, ...]  # names of codec/video.py, the best first; others are not known here
    key: bool = False  # it cannot go on from what it has


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOptions:
    """How a client wants its pictures: one object from the message to what draws and to what encodes."""

    quality: int = 80  # JPEG
    crop: bool = False
    alpha: Alpha = False  # the accumulated alpha too
    hide: tuple[str, ...] = ()  # parts of the avatar to leave out, each once, sorted
    box: bool = False  # where the avatar is, too
    depth: bool = False  # how far away what it shows is, too
    light: Light | None = None  # that falls on it, in the space of the cameras; None: the server's
    video: Video | None = None  # it may be part of a video; None: a JPEG


class Wishes(TypedDict, total=False):
    """How a client of this package wants its pictures.

    ``quality`` is JPEG's. ``crop`` has only the covered part sent, ``alpha`` the accumulated alpha too (``Reply.rgba``;
    "straight" keeps the silhouette cleaner at the same quality). ``mirror`` overrules what the connection asked for.
    ``hide`` leaves parts of the avatar out: ("head",). ``box`` has the server say where the avatar is (``Reply.box``),
    ``depth`` how far away what is shown is (``Reply.depth``). ``light`` (cameras' axes) falls instead of the server's.
    """

    quality: int | None
    crop: bool
    alpha: Alpha
    mirror: bool | None
    hide: Sequence[str]
    box: bool
    depth: bool
    light: Light | str | None


DEFAULT = PictureOptions()


class Message(msgspec.Struct):
    """A request, or an acknowledgement; null is the same as absent where a type allows it."""

    v: int | None = None
    frame_id: int | None = None
    ack: int | None = None
    arrival: Arrival | None = None
    t: float | None = None
    want: str | None = None
    eyes: list[Eye] | None = None
    size: list[int] | None = None
    quality: int | None = None
    crop: bool = False
    alpha: bool | str = False
    mirror: bool | None = None
    hide: list[str] | None = None
    box: bool = False
    depth: bool = False
    pose: PoseFields | None = None
    tracking: Tracking | None = None
    faces: list[Place] | None = None
    light: LightFields | str | None = None
    video: Video | None = None
    datagrams: bool = False


class LegacyMessage(msgspec.Struct):
    """What older clients send; these keys mean nothing in a message that names its version."""

    cameras: list[LegacyCamera] | None = None
    camera: LegacyCamera | None = None
    smplx: PoseFields | None = None


PICTURE = tuple(
    "want eyes size quality crop alpha mirror hide box depth pose tracking faces light video datagrams".split()
)
"""Fields that only a request has."""


def given(fields: PoseFields | Tracking) -> dict[str, Any]:
    """What of it is there, by the wire's names."""
    return {key: value for key, value in msgspec.structs.asdict(fields).items() if value is not None}


def sample_of(m: Tracking, t: float, farthest: float) -> tuple[Sample, str]:
    """The sample at ``t`` seconds, and why there is none, which is said once its picture is due ("": there is one).

    Types, counts and metres (up to ``farthest``) are looked at here and nowhere else; what a body can do is the
    tracker's to judge. Raises ProtocolError and, of an expression, PoseError for what is refused at once.
    """
    poses: dict[str, Any] = {}
    for name in (*WRISTS, *TRACKERS):
        pose = poses[name] = getattr(m, name)
        if pose is None:
            continue
        if len(pose) != 7:
            raise ProtocolError(f"tracking.{name} needs [x, y, z, qx, qy, qz, qw], not {len(pose)} numbers")
        if max(map(abs, pose[:3])) > farthest:
            raise ProtocolError(f"tracking.{name} needs metres below {farthest:g}")
        if not 1e-9 < hypot(*pose[3:]) < 1e3:  # no matrix is made of it here: that takes 0.1 ms
            raise ProtocolError(f"tracking.{name} needs a quaternion of about unit length", "bad_camera")
    expression = checked_expression(m.expression)
    for name, gaze in (("leftEye", m.leftEye), ("rightEye", m.rightEye)):
        if gaze is not None and not (len(gaze) == 3 and 1e-6 < hypot(*gaze) < 1e6):
            raise ProtocolError(f"tracking.{name} needs a direction of 3 numbers that are not all 0")
    body = _body(m.body, farthest)
    try:
        if all(poses[name] is None for name in WRISTS):
            return Sample.from_json(given(m), t), ""  # which says what is missing
        left_joints, right_joints = _hand(m.left_joints, "left_joints"), _hand(m.right_joints, "right_joints")
    except PoseError as error:
        return Sample(t), str(error)
    for side in ("left", "right"):
        grip = poses.pop(f"{side}_grip")
        if poses[side] is None and grip is not None:
            poses[side] = wrist_from_grip(grip, side)
    sample = Sample(
        t,
        **poses,
        left_joints=left_joints,
        right_joints=right_joints,
        left_curl=m.left_curl,
        right_curl=m.right_curl,
        body=body,
        expression=None if m.expression is None else expression,
        left_eye=m.leftEye,
        right_eye=m.rightEye,
    )
    return sample, ""


def faces_of(value: Sequence[Place] | None, farthest: float) -> tuple[Place, ...]:
    """The places of faces that may be looked at. Raises ProtocolError for too many, and beyond ``farthest`` metres."""
    if value is None:
        return ()
    if len(value) > MOST_FACES:
        raise ProtocolError(f"faces needs at most {MOST_FACES} places, not {len(value)}")
    if any(max(map(abs, place)) > farthest for place in value):
        raise ProtocolError(f"faces needs metres below {farthest:g}")
    return tuple(value)


def video_of(value: Video | None) -> Video | None:
    """What a client can decode. Raises ProtocolError for names that are none, or too many."""
    if value is None:
        return None
    if not (1 <= len(value.codecs) <= MOST_CODECS and all(0 < len(codec) <= 32 for codec in value.codecs)):
        raise ProtocolError(f"video.codecs needs 1 to {MOST_CODECS} names of up to 32 characters, the best first")
    return value


def light_of(value: LightFields | str | None) -> Light | None:
    """The light that falls on what is shown, in the space of the eyes. Raises ProtocolError for what is none."""
    if value is None:
        return None
    from glsplat.light.light import Light  # here: clients and most requests have none

    try:
        return Light.from_json(msgspec.to_builtins(value))
    except FormatError as error:
        raise ProtocolError(f"light: {error}") from None


def _hand(value: Numbers | None, key: str) -> Joints | None:
    """As ``hand_joints``, without another look at numbers that are known to be some."""
    if value is None:
        return None
    joints = grouped(value, key)
    if len({*map(type, value)}) > 1 or not {*map(len, joints)} <= {3, 7}:
        return hand_joints(value, key)  # which says what is wrong
    return tuple(map(tuple, joints))


def _body(body: dict[str, tuple[float, ...] | None] | None, farthest: float) -> dict[str, tuple[float, ...]] | None:
    """The joints that are used; the others are not looked at."""
    if body is None:
        return None
    if len(body) > MOST_JOINTS:
        raise ProtocolError(f"tracking.body needs at most {MOST_JOINTS} joints, not {len(body)}")
    found: dict[str, tuple[float, ...]] = {}
    for name in BODY_JOINTS:
        joint = body.get(name)
        if joint is None:
            continue
        if len(joint) not in (3, 7):
            raise ProtocolError(f"tracking.body.{name} needs 3 or 7 numbers, not {len(joint)}")
        if max(map(abs, joint[:3])) > farthest:
            raise ProtocolError(f"tracking.body.{name} needs metres below {farthest:g}")
        found[name] = joint
    return found
