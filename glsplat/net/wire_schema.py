"""The fields of a request on the wire (docs/protocol.md, section 3): their types, and checks of single fields.

Unknown keys are ignored. The types bound the nesting; messages.py checks limits and combinations of fields.
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

DEFAULT_NEAR_M, DEFAULT_FAR_M, DEFAULT_SH_DEGREE = 0.01, 1e10, 3  # of an eye without these fields, as of Camera

Numbers = list[float | list[float]]  # flat or nested once

Expression = dict[str, float] | list[float]  # by name, or in ARKit's order

Joints = tuple[tuple[float, ...], ...]

Position = tuple[float, float, float]

MAX_FACES = 16  # of a request
MAX_CODECS = 8  # of a request

Alpha = bool | Literal["straight"]
"""Whether alpha is sent, too; colours are premultiplied (over black), or "straight" (codec/encode.py)."""

Want = Literal["picture", "pose"]
"""The answer to a request: a picture, or the poses of people whom the client draws itself."""


class Eye(msgspec.Struct):
    """A camera: the world-to-camera matrix row by row, and [fx, fy, cx, cy] in pixels."""

    viewmat: list[float]
    K: list[float]
    near: float = DEFAULT_NEAR_M
    far: float = DEFAULT_FAR_M
    sh_degree: int = DEFAULT_SH_DEGREE


class Tracking(msgspec.Struct):
    """The fields of a tracking sample (glsplat.tracking.sample); null means not tracked."""

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
    leftEye: tuple[float, ...] | None = None  # noqa: N815 - the wire's name
    rightEye: tuple[float, ...] | None = None  # noqa: N815


class PoseFields(msgspec.Struct):
    """A pose in either layout of glsplat.skinning.pose."""

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
    """The directional light of a glsplat.light.Light."""

    direction: tuple[float, ...]
    color: tuple[float, ...]


class LightFields(msgspec.Struct):
    """The fields of Light.from_json."""

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
    """A client's report on the picture that ``ack`` names. Milliseconds."""

    age: float  # from its request until it arrived, or was shown
    held: float = 0.0  # from its arrival until this message


class Video(msgspec.Struct, frozen=True):
    """The video that a client can decode."""

    codecs: tuple[str, ...]  # names of extras/far_links/video.py, the best first; others are ignored
    key: bool = False  # the client needs a key picture: it lost the one before


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOptions:
    """Options of a picture, for the renderer and the encoder."""

    quality: int = 80  # JPEG
    crop: bool = False  # send the covered part only
    alpha: Alpha = False  # send the accumulated alpha, too
    hide: tuple[str, ...] = ()  # parts of the avatar to leave out, each once, sorted
    box: bool = False  # report the avatar's bounding box
    depth: bool = False  # send a depth grid, too
    light: Light | None = None  # in the space of the cameras; None: the server's
    video: Video | None = None  # the picture may be part of a video; None: a JPEG


class PictureParams(TypedDict, total=False):
    """Options of a picture, as arguments of ``Client``.

    ``quality`` is JPEG's. ``crop`` sends the covered part only. ``alpha`` sends the accumulated alpha, too
    (``Reply.rgba``); "straight" keeps the silhouette cleaner at the same quality. ``mirror`` overrides the connection's
    option. ``hide`` leaves out parts of the avatar: ("head",). ``box`` requests its bounding box (``Reply.box``),
    ``depth`` a depth grid (``Reply.depth``). ``light``, in the cameras' axes, replaces the server's.
    """

    quality: int | None
    crop: bool
    alpha: Alpha
    mirror: bool | None
    hide: Sequence[str]
    box: bool
    depth: bool
    light: Light | str | None


DEFAULT_OPTIONS = PictureOptions()


class Message(msgspec.Struct):
    """A request or an acknowledgement. Where null is allowed, it is the same as an absent key."""

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
    faces: list[Position] | None = None
    light: LightFields | str | None = None
    video: Video | None = None
    datagrams: bool = False


class LegacyMessage(msgspec.Struct):
    """The keys of older clients; ignored in a message that has a version."""

    cameras: list[LegacyCamera] | None = None
    camera: LegacyCamera | None = None
    smplx: PoseFields | None = None


REQUEST_ONLY = tuple(
    "want eyes size quality crop alpha mirror hide box depth pose tracking faces light video datagrams".split()
)
"""Fields that an acknowledgement lacks."""


def present_fields(fields: PoseFields | Tracking) -> dict[str, Any]:
    """Return the fields that are not None, by the wire's names."""
    return {key: value for key, value in msgspec.structs.asdict(fields).items() if value is not None}


def sample_of(m: Tracking, t: float, max_metres: float) -> tuple[Sample, str]:
    """Return the sample at ``t`` seconds, and "", or why it cannot be solved; that fails its picture.

    Counts, quaternions and positions (up to ``max_metres``) are checked here only; the tracker judges the pose.
    Raises ProtocolError, and PoseError for an expression, where the message is refused at once.
    """
    poses: dict[str, Any] = {}
    for name in (*WRISTS, *TRACKERS):
        pose = poses[name] = getattr(m, name)
        if pose is None:
            continue
        if len(pose) != 7:
            raise ProtocolError(f"tracking.{name} needs [x, y, z, qx, qy, qz, qw], not {len(pose)} numbers")
        if max(map(abs, pose[:3])) > max_metres:
            raise ProtocolError(f"tracking.{name} needs metres below {max_metres:g}")
        if not 1e-9 < hypot(*pose[3:]) < 1e3:  # making a matrix of it would take 0.1 ms
            raise ProtocolError(f"tracking.{name} needs a quaternion of about unit length", "bad_camera")
    expression = checked_expression(m.expression)
    for name, gaze in (("leftEye", m.leftEye), ("rightEye", m.rightEye)):
        if gaze is not None and not (len(gaze) == 3 and 1e-6 < hypot(*gaze) < 1e6):
            raise ProtocolError(f"tracking.{name} needs a direction of 3 numbers that are not all 0")
    body = _body(m.body, max_metres)
    try:
        if all(poses[name] is None for name in WRISTS):
            return Sample.from_json(present_fields(m), t), ""  # raises: it names what is missing
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


def checked_faces(value: Sequence[Position] | None, max_metres: float) -> tuple[Position, ...]:
    """Return the positions of faces, of which an avatar may look at one. Raises ProtocolError."""
    if value is None:
        return ()
    if len(value) > MAX_FACES:
        raise ProtocolError(f"faces needs at most {MAX_FACES} places, not {len(value)}")
    if any(max(map(abs, place)) > max_metres for place in value):
        raise ProtocolError(f"faces needs metres below {max_metres:g}")
    return tuple(value)


def checked_video(value: Video | None) -> Video | None:
    """Return a client's video options. Raises ProtocolError for too many codecs or malformed names."""
    if value is None:
        return None
    if not (1 <= len(value.codecs) <= MAX_CODECS and all(0 < len(codec) <= 32 for codec in value.codecs)):
        raise ProtocolError(f"video.codecs needs 1 to {MAX_CODECS} names of up to 32 characters, the best first")
    return value


def checked_light(value: LightFields | str | None) -> Light | None:
    """Return the light of a request, in the space of the eyes. Raises ProtocolError."""
    if value is None:
        return None
    from glsplat.light.light import Light  # loaded late: clients and most requests have none

    try:
        return Light.from_json(msgspec.to_builtins(value))
    except FormatError as error:
        raise ProtocolError(f"light: {error}") from None


def _hand(value: Numbers | None, key: str) -> Joints | None:
    """Return the joints of a hand, like ``hand_joints`` but without its checks that the decoder has done."""
    if value is None:
        return None
    joints = grouped(value, key)
    if len({*map(type, value)}) > 1 or not {*map(len, joints)} <= {3, 7}:
        return hand_joints(value, key)  # raises: it names the fault
    return tuple(map(tuple, joints))


def _body(body: dict[str, tuple[float, ...] | None] | None, max_metres: float) -> dict[str, tuple[float, ...]] | None:
    """Return the joints that the tracker uses; others are not checked."""
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
        if max(map(abs, joint[:3])) > max_metres:
            raise ProtocolError(f"tracking.body.{name} needs metres below {max_metres:g}")
        found[name] = joint
    return found
