"""A client's requests as JSON objects (docs/protocol.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import msgspec
import numpy as np

from glsplat.camera import Camera
from glsplat.errors import ProtocolError
from glsplat.net.messages import VERSION, eye_fields
from glsplat.net.wire_schema import PictureParams, Want
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES


def request_message(
    frame_id: int,
    cameras: Sequence[Camera] | None = None,
    *,
    pose: Pose | Mapping[str, Any] | None = None,
    tracking: Mapping[str, Any] | None = None,
    want: Want | None = None,
    t: float | None = None,
    **params: Unpack[PictureParams],
) -> dict[str, Any]:
    """Return a native request. ``cameras`` may be left out where ``tracking`` has a head. Raises ProtocolError."""
    message: dict[str, Any] = {"v": VERSION, "frame_id": frame_id}
    if t is not None:
        message["t"] = t
    if cameras is not None:
        message |= _eyes(cameras)
    if isinstance(pose, Pose):
        if len(pose.rotations) != len(JOINT_NAMES):
            raise ProtocolError('a pose of another rig than SMPL-X is sent as {"joints": {NAME: [x, y, z]}}')
        pose = pose.to_smplx()
    known = PictureParams.__annotations__
    if unknown := params.keys() - known.keys():
        raise TypeError(f"a request has no {', '.join(sorted(unknown))}: it has {', '.join(known)}")
    fields: dict[str, Any] = {"pose": pose, "tracking": tracking, "want": want, **params}
    for key in ("crop", "alpha", "box", "depth"):
        fields[key] = fields.get(key) or None
    hide, light = params.get("hide", ()), params.get("light")
    fields["hide"] = ([hide] if isinstance(hide, str) else list(hide)) or None
    fields["light"] = light if light is None or isinstance(light, str) else light.to_json()
    return message | {key: value for key, value in fields.items() if value is not None}


def _eyes(cameras: Sequence[Camera]) -> dict[str, Any]:
    """Return ``eyes`` and ``size``. Raises ProtocolError for properties of cameras that the wire cannot hold."""
    views = [cameras] if isinstance(cameras, Camera) else list(cameras)
    if not 1 <= len(views) <= 2 or not all(isinstance(camera, Camera) for camera in views):
        raise ProtocolError("a request has one or two cameras (glsplat.Camera), left first; leave them out for a head")
    sizes = [(camera.width, camera.height) for camera in views]
    if sizes[0] != sizes[-1]:
        (w, h), (w2, h2) = sizes
        raise ProtocolError(f"both eyes need one size, not {w}x{h} and {w2}x{h2}", "bad_size")
    if any(tuple(camera.background) != (0, 0, 0) for camera in views):
        raise ProtocolError("a server draws on black: leave background at (0, 0, 0)", "bad_camera")
    if any((np.linalg.det(camera.viewmat[:3, :3])) < 0 for camera in views):
        raise ProtocolError("a viewmat that reflects is not sent: ask for mirror=True", "bad_camera")
    return {"eyes": [eye_fields(camera) for camera in views], "size": list(sizes[0])}


def _plain(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"a request holds numbers, lists and arrays, not {type(value).__name__}")


encoder: msgspec.json.Encoder = msgspec.json.Encoder(enc_hook=_plain)
