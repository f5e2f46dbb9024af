"""Decodes requests: JSON text to a checked, frozen Request (docs/protocol.md). No I/O, no state.

There are three forms: the native one has a version (``v``), the two of older clients have none (``cameras`` with
``smplx``, and one ``camera`` with ``smplx``).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import ORTHONORMAL, PAPER_FOV, PAPER_IPD, Camera, head_matrix, stereo_cameras
from glsplat.errors import FormatError, PoseError, ProtocolError
from glsplat.net.wire_schema import (
    DEFAULT_FAR_M,
    DEFAULT_NEAR_M,
    DEFAULT_OPTIONS,
    DEFAULT_SH_DEGREE,
    REQUEST_ONLY,
    Alpha,
    Arrival,
    Eye,
    LegacyCamera,
    LegacyMessage,
    Message,
    PictureOptions,
    Position,
    checked_faces,
    checked_light,
    checked_video,
    present_fields,
    sample_of,
)
from glsplat.rotations import FLIP_X, FLIP_Z, nearest_rotations
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import POSE_KEYS
from glsplat.tracking.sample import Sample

if TYPE_CHECKING:
    from glsplat.light.light import Light


class _DuplicateError(Exception):
    pass


def _once(pairs: list[tuple[str, Any]]) -> None:
    if len({key for key, _ in pairs}) != len(pairs):
        raise _DuplicateError


_plain = msgspec.json.Decoder()
# numbers are not parsed: Python refuses integers of 5000 digits
_exact = json.JSONDecoder(object_pairs_hook=_once, parse_int=len, parse_float=len, strict=False)


def has_duplicates(data: str | bytes) -> bool:
    """Return whether an object of this valid JSON text has a key twice, however the key is escaped.

    Every pair has one colon: where decoded objects have as many keys as the text has colons, no pair was lost. That
    costs a tenth of the exact check, which colons in strings make necessary.
    """
    text = data if isinstance(data, str) else data.decode("utf-8", "replace")
    if _keys(_plain.decode(text)) == text.count(":"):
        return False
    try:
        _exact.decode(text)
    except _DuplicateError:
        return True
    return False


def _keys(value: Any) -> int:
    """Return the number of keys in ``value``, except in lists whose first member is no object."""
    if type(value) is dict:
        return len(value) + sum(_keys(v) for v in value.values() if type(v) is dict or type(v) is list)
    if type(value) is list and value and type(value[0]) is dict:
        return sum(map(_keys, value))
    return 0


VERSION = 1
MAX_MESSAGE_BYTES = 64 * 1024
"""Largest text message; a request with tracking of all fingers has 2 to 4 kB."""

Form = Literal["native", "bundle-legacy", "single-legacy"]
MAX_ID = 2**32 - 1
PARTS = ("head",)
"""Parts of an avatar that a request may hide: the splats of the joint of that name and of its descendants."""

_MAX_CLIENT_ROTATION_ERROR = 1e-3  # largest entry of R R^T - I; float32 clients stay below 1e-6
_MAX_ROTATION_ERROR = ORTHONORMAL / 2  # above it the nearest rotation replaces R: transforms in rooms add rounding
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # rows of a rotation
MAX_ARRIVAL_MS = 60_000.0  # largest time in an ``arrival``
_MIN_NEAR_M = 1e-6  # metres


@dataclass(frozen=True, slots=True, kw_only=True)
class WireOptions:
    """Limits of requests, and defaults for the fields that they lack."""

    size: tuple[int, int] = (1024, 1024)  # pixels an eye
    max_side: int = 2048  # pixels
    quality: int = 80  # JPEG
    ipd: float = PAPER_IPD  # metres; of head poses without eyes
    fov: float = PAPER_FOV  # vertical degrees; of head poses without eyes
    mirror: bool = False  # reflect the world in x, as a mirror in front of the user does
    max_distance: float = 1e4  # metres from the origin, of eyes and tracked points
    light: Light | None = None  # the scene's light, as /session reports it


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Request:
    """A request for a picture of one or two eyes, or for ``poses``, which has no cameras."""

    frame_id: int | None  # None: an older client sent none
    cameras: tuple[Camera, ...]  # one or two, left first; none for poses
    pose: Pose | None = None  # None and no tracking: the rest pose
    tracking: Sample | None = None  # its time is unknown where ``t`` is None
    fault: str = ""  # why ``tracking`` cannot be solved; fails the picture
    t: float | None = None  # milliseconds of the client's clock, echoed
    ack: int | None = None  # newest frame_id that the client has received
    arrival: Arrival | None = None  # report on the picture of ``ack``
    options: PictureOptions = DEFAULT_OPTIONS
    form: Form = "native"
    eyes: tuple[int, ...] = (0, 1)  # eye numbers of the cameras: 0 left, 1 right
    poses: bool = False  # the client draws by itself
    datagrams: bool = False  # the client accepts pictures by datagrams
    faces: tuple[Position, ...] = ()  # faces that a tracked avatar may look at, in its user's space


@dataclass(frozen=True, slots=True)
class Ack:
    """A message that only acknowledges: {"v": 1, "ack": 7}."""

    frame_id: int
    arrival: Arrival | None = None


_decoder = msgspec.json.Decoder(Message)
_legacy_decoder = msgspec.json.Decoder(LegacyMessage)
_encoder = msgspec.json.Encoder()


class Decoder:
    """Decodes the messages of one session.

    ``skeleton`` None means the 55 joints of SMPL-X; ``parts`` are the avatar's parts that can be hidden.
    """

    def __init__(
        self,
        options: WireOptions | None = None,
        skeleton: Skeleton | None = None,
        parts: frozenset[str] = frozenset(),
    ) -> None:
        self.options: WireOptions = options or WireOptions()
        self.skeleton, self.parts = skeleton, parts

    def decode(self, data: str | bytes) -> Request | Ack:
        """Decode a message. Raises ProtocolError, with the frame_id where it could be read."""
        size = len(data) if isinstance(data, bytes) else len(data.encode("utf-8", "replace"))
        if size > MAX_MESSAGE_BYTES:
            raise ProtocolError(f"a message needs at most {MAX_MESSAGE_BYTES} bytes, not {size}", "too_big")
        try:
            message = _decoder.decode(data)
            legacy = _legacy_decoder.decode(data) if message.v is None else None
            repeated = has_duplicates(data)
        except msgspec.ValidationError as error:
            raise ProtocolError(_line(str(error)), "bad_field") from None
        except (msgspec.DecodeError, ValueError) as error:
            raise ProtocolError(_line(str(error)), "bad_json") from None
        except RecursionError:
            raise ProtocolError("the message is nested too deeply", "bad_json") from None
        if repeated:
            raise ProtocolError("an object gives a key twice", "bad_json", _safe_id(message.frame_id))
        try:
            if legacy is None or (legacy.cameras is None and legacy.camera is None):
                return self._native(message)
            return self._legacy(message, legacy)
        except (FormatError, PoseError) as error:
            code = "bad_pose" if isinstance(error, PoseError) else "bad_camera"
            raise ProtocolError(_line(str(error)), code, _safe_id(message.frame_id)) from None
        except ProtocolError as error:
            raise ProtocolError(_line(str(error)), error.code, _safe_id(message.frame_id)) from None

    def _native(self, m: Message) -> Request | Ack:
        _check_ids(m)
        if m.v != VERSION:
            found = "none" if m.v is None else f"{m.v}"[:20]
            raise ProtocolError(f'this server speaks version {VERSION}: send "v": {VERSION}, not {found}', "version")
        if m.frame_id is None:
            present = [name for name in REQUEST_ONLY if getattr(m, name) not in (None, False)]
            if m.ack is None or present:
                raise ProtocolError("a request needs frame_id" + (f" (found {', '.join(present)})" if present else ""))
            return Ack(m.ack, m.arrival)
        if m.pose is not None and m.tracking is not None:
            raise ProtocolError("a request has either pose or tracking, not both")
        if m.want not in (None, "picture", "pose"):
            raise ProtocolError(f'want needs "picture" or "pose", not {m.want!r:.20}')
        o = self.options
        sample, fault = None, ""
        if m.tracking is not None:
            sample, fault = sample_of(m.tracking, (m.t or 0.0) / 1e3, o.max_distance)
        request = Request(
            frame_id=m.frame_id,
            cameras=(),
            pose=None if m.pose is None else self._pose(present_fields(m.pose)),
            tracking=sample,
            fault=fault,
            t=m.t,
            ack=m.ack,
            arrival=m.arrival,
            eyes=(),
            poses=m.want == "pose",
            faces=checked_faces(m.faces, o.max_distance),
        )
        return request if request.poses else self._picture(request, m)

    def _picture(self, request: Request, m: Message) -> Request:
        """Return ``request`` with the cameras and options of its picture."""
        o = self.options
        size = self._size(m.size)
        quality = o.quality if m.quality is None else m.quality
        if not 1 <= quality <= 100:
            raise ProtocolError("quality needs a whole number from 1 to 100")
        if m.eyes is not None:
            if not 1 <= len(m.eyes) <= 2:
                raise ProtocolError(f"eyes needs one or two entries, not {len(m.eyes)}")
            cameras = tuple(self._eye(eye, size) for eye in m.eyes)
        elif m.tracking is not None and m.tracking.head is not None:
            head = m.tracking.head
            cameras = stereo_cameras(_head(head[:3], head[3:]), o.ipd, o.fov, size=size)
        else:
            raise ProtocolError('a request needs "eyes": one or two of {"viewmat", "K"}')
        return replace(
            request,
            cameras=_mirrored(cameras) if (o.mirror if m.mirror is None else m.mirror) else cameras,
            options=PictureOptions(
                quality=quality,
                crop=m.crop,
                alpha=_alpha(m.alpha),
                hide=self._hidden(m.hide or []),
                box=m.box,
                depth=m.depth,
                light=checked_light(m.light),
                video=checked_video(m.video),
            ),
            eyes=tuple(range(len(cameras))),
            datagrams=m.datagrams,
        )

    def _legacy(self, m: Message, old: LegacyMessage) -> Request:
        """Decode head poses in Unity's frame; IPD, field of view and size are the server's."""
        _check_ids(m)
        o = self.options
        heads = [old.camera] if old.camera is not None else old.cameras or []
        heads = sorted(heads, key=lambda head: head.eye)
        if not 1 <= len(heads) <= 2 or len({head.eye for head in heads}) != len(heads):
            raise ProtocolError("cameras needs one or two entries of different eyes")
        cameras = []
        for head in heads:
            pair = stereo_cameras(_head_from_unity(head), o.ipd, o.fov, size=o.size)
            cameras.append(self._placed(pair[head.eye == "right"]))
        smplx = {} if old.smplx is None else present_fields(old.smplx)
        pose = {key: value for key, value in smplx.items() if key in POSE_KEYS}  # trans is ignored, as in their server
        return Request(
            frame_id=m.frame_id,
            cameras=_mirrored(cameras) if o.mirror else tuple(cameras),
            pose=self._pose(pose) if pose else None,
            options=PictureOptions(quality=o.quality),
            form="single-legacy" if old.camera is not None else "bundle-legacy",
            eyes=tuple(int(head.eye == "right") for head in heads),
        )

    def _size(self, size: list[int] | None) -> tuple[int, int]:
        if size is None:
            return self.options.size
        limit = self.options.max_side
        if len(size) != 2 or not all(1 <= side <= limit for side in size):
            raise ProtocolError(f"size needs [width, height], each from 1 to {limit}", "bad_size")
        return size[0], size[1]

    def _eye(self, eye: Eye, size: tuple[int, int]) -> Camera:
        if len(eye.viewmat) != 16 or len(eye.K) != 4:
            raise ProtocolError(f"an eye needs 16 numbers in viewmat and 4 in K, not {len(eye.viewmat)}, {len(eye.K)}")
        fx, fy, cx, cy = eye.K
        if not (max(abs(v) for v in eye.K) < 1e6 and min(fx, fy) > 1e-3):
            raise ProtocolError("K needs [fx, fy, cx, cy] in pixels below 1e6, fx and fy above 0.001", "bad_camera")
        # plain floats: made for every request
        a, b, c = rows = eye.viewmat[0:3], eye.viewmat[4:7], eye.viewmat[8:11]
        off = 0.0
        for i, j in _PAIRS:
            one, other = rows[i], rows[j]
            error = abs(one[0] * other[0] + one[1] * other[1] + one[2] * other[2] - (i == j))
            if not error <= _MAX_CLIENT_ROTATION_ERROR:  # also NaN: 1e300 is finite, its square is not
                raise ProtocolError("viewmat needs an orthonormal rotation (world to camera, row by row)", "bad_camera")
            off = max(off, error)
        x, y, z = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
        if a[0] * x + a[1] * y + a[2] * z < 0:  # the determinant
            raise ProtocolError('viewmat is a reflection; for a mirror picture send "mirror": true', "bad_camera")
        if not _MIN_NEAR_M <= eye.near < eye.far <= DEFAULT_FAR_M:
            raise ProtocolError(
                f"an eye needs {_MIN_NEAR_M:g} <= near < far <= {DEFAULT_FAR_M:g} (metres)", "bad_camera"
            )
        if not 0 <= eye.sh_degree <= DEFAULT_SH_DEGREE:
            raise ProtocolError(f"sh_degree needs a whole number from 0 to {DEFAULT_SH_DEGREE}", "bad_camera")
        viewmat = np.array(eye.viewmat).reshape(4, 4)
        if off > _MAX_ROTATION_ERROR:  # keep the camera's position
            rotation = viewmat[:3, :3]
            exact = np.eye(4)
            exact[:3, :3] = nearest_rotations(rotation[None])[0]
            exact[:3, 3] = exact[:3, :3] @ np.linalg.solve(rotation, viewmat[:3, 3])
            viewmat = exact
        k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        return self._placed(Camera(viewmat, k, *size, near=eye.near, far=eye.far, sh_degree=eye.sh_degree))

    def _placed(self, camera: Camera) -> Camera:
        limit = self.options.max_distance
        if not np.abs(camera.position).max() <= limit:
            raise ProtocolError(f"an eye needs to be within {limit:g} m of the origin", "bad_camera")
        return camera

    def _hidden(self, parts: Sequence[str]) -> tuple[str, ...]:
        """Return the parts to hide, sorted. Raises ProtocolError for parts that the avatar lacks."""
        for part in parts:
            if part not in PARTS:
                raise ProtocolError(f"hide knows {', '.join(PARTS)}; found another word")
            if part not in self.parts:
                raise ProtocolError(f'"hide": ["{part}"] needs one avatar that has a joint of that name')
        return tuple(sorted(set(parts)))

    def _pose(self, pose: Mapping[str, Any]) -> Pose:
        return Pose.from_smplx(pose) if self.skeleton is None else Pose.from_json(pose, self.skeleton)


def _mirrored(cameras: Sequence[Camera]) -> tuple[Camera, ...]:
    """Return the cameras for a world that is reflected in x."""
    return tuple(
        Camera(c.viewmat @ FLIP_X, c.K, c.width, c.height, c.background, c.near, c.far, c.sh_degree, c.name)
        for c in cameras
    )


def eye_fields(camera: Camera) -> dict[str, Any]:
    """Return a camera's fields in requests and replies: {"viewmat": 16 numbers, "K": [fx, fy, cx, cy]}.

    near, far (metres) and sh_degree are added where they are not the default.
    """
    k = camera.K
    fields: dict[str, Any] = {
        "viewmat": camera.viewmat.ravel().tolist(),
        "K": [float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])],
    }
    for name, default in (("near", DEFAULT_NEAR_M), ("far", DEFAULT_FAR_M), ("sh_degree", DEFAULT_SH_DEGREE)):
        value = getattr(camera, name)
        if value != default:
            fields[name] = value
    return fields


def _alpha(value: bool | str) -> Alpha:
    if isinstance(value, bool):
        return value
    if value == "straight":
        return "straight"
    raise ProtocolError(f'alpha needs true, false or "straight", not {value!r:.20}')


def _check_ids(m: Message) -> None:
    for name, value in (("frame_id", m.frame_id), ("ack", m.ack)):
        if value is not None and not 0 <= value <= MAX_ID:
            raise ProtocolError(f"{name} needs a whole number from 0 to {MAX_ID}")
    if m.arrival is not None:
        if m.ack is None:
            raise ProtocolError("arrival needs ack, the frame_id of its picture")
        if not all(0 <= ms <= MAX_ARRIVAL_MS for ms in (m.arrival.age, m.arrival.held)):
            raise ProtocolError(f"arrival needs milliseconds from 0 to {MAX_ARRIVAL_MS:g} in age and held")


def error_text(code: str, message: str, frame_id: int | None = None) -> str:
    """Return the text message that reports an error to a client."""
    return _encoder.encode({"error": {"code": code, "message": _line(message), "frame_id": frame_id}}).decode()


def _head(position: Sequence[float], rotation: Sequence[float]) -> NDArray[np.float64]:
    """Return T_W_H [4, 4]. Raises FormatError or ProtocolError for an invalid quaternion."""
    if max(map(abs, rotation)) > 1e3:  # 1e300 is finite, its square is not
        raise ProtocolError("a quaternion needs numbers of about unit length", "bad_camera")
    return head_matrix(position, rotation)


def _head_from_unity(head: LegacyCamera) -> NDArray[np.float64]:
    """Return T_W_H [4, 4] of a pose in Unity's left-handed frame: S_x p, S_x R S_z (docs/conventions.md)."""
    unity = _head((head.pos_x, head.pos_y, head.pos_z), (head.rot_x, head.rot_y, head.rot_z, head.rot_w))
    return FLIP_X @ unity @ FLIP_Z


def _safe_id(frame_id: int | None) -> int | None:
    return frame_id if frame_id is not None and 0 <= frame_id <= MAX_ID else None


def _line(message: str) -> str:
    """Return one printable line of bounded length: the peer may have sent parts of ``message``."""
    return "".join(c if c.isprintable() else " " for c in message[:300])
