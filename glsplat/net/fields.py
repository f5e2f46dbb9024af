"""The fields of a request as they stand on the wire (docs/protocol.md, section 3): their types, not their limits.

Unknown keys are ignored. Types bound the depth of what is read; messages.py checks the rest.
"""

from __future__ import annotations

from typing import Literal

import msgspec

__all__ = [
    "FAR",
    "NEAR",
    "PICTURE",
    "SH_DEGREE",
    "Alpha",
    "Eye",
    "LegacyCamera",
    "LegacyMessage",
    "Message",
    "PoseFields",
    "Tracking",
]

NEAR, FAR, SH_DEGREE = 0.01, 1e10, 3  # of an eye whose request is silent: Camera's own defaults

Numbers = list[float | list[float]]  # flat or nested once

Expression = dict[str, float] | list[float]  # by name, or in ARKit's order

Alpha = bool | Literal["straight"]
"""Whether alpha is sent too: with colours over black (premultiplied), or with straight ones (codec/straight.py)."""


class Eye(msgspec.Struct):
    """A camera: world to camera row by row, and [fx, fy, cx, cy] in pixels."""

    viewmat: list[float]
    K: list[float]
    near: float = NEAR
    far: float = FAR
    sh_degree: int = SH_DEGREE


class Tracking(msgspec.Struct):
    """The fields of glsplat.tracking.sample; null means not tracked."""

    head: list[float] | None = None
    left: list[float] | None = None
    right: list[float] | None = None
    left_grip: list[float] | None = None
    right_grip: list[float] | None = None
    left_joints: Numbers | None = None
    right_joints: Numbers | None = None
    left_curl: float | None = None
    right_curl: float | None = None
    waist: list[float] | None = None
    left_foot: list[float] | None = None
    right_foot: list[float] | None = None
    body: dict[str, list[float] | None] | None = None
    expression: Expression | None = None
    leftEye: list[float] | None = None  # noqa: N815 - names of the wire
    rightEye: list[float] | None = None  # noqa: N815


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


class Message(msgspec.Struct):
    """A request, or an acknowledgement; null is the same as absent where a type allows it."""

    v: int | None = None
    frame_id: int | None = None
    ack: int | None = None
    t: float | None = None
    eyes: list[Eye] | None = None
    size: list[int] | None = None
    quality: int | None = None
    crop: bool = False
    alpha: bool | str = False
    mirror: bool | None = None
    hide: list[str] | None = None
    box: bool = False
    pose: PoseFields | None = None
    tracking: Tracking | None = None


class LegacyMessage(msgspec.Struct):
    """What older clients send; these keys mean nothing in a message that names its version."""

    cameras: list[LegacyCamera] | None = None
    camera: LegacyCamera | None = None
    smplx: PoseFields | None = None


PICTURE = ("eyes", "size", "quality", "crop", "alpha", "mirror", "hide", "box", "pose", "tracking")
"""Fields that only a request for a picture has."""
