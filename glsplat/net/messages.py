"""Requests: JSON text to a checked, frozen Request (docs/protocol.md). No I/O, no state.

Three forms arrive on the same socket: the native one, which names its version (``v``), and two that older clients send,
which know none (``cameras`` with ``smplx``, and one ``camera`` with ``smplx``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import ORTHONORMAL, PAPER_FOV, PAPER_IPD, Camera, head_matrix, stereo_cameras
from glsplat.errors import FormatError, PoseError, ProtocolError
from glsplat.net.guard.duplicates import has_duplicates
from glsplat.net.wire_schema import (
    DEFAULT,
    FAR,
    NEAR,
    PICTURE,
    SH_DEGREE,
    Alpha,
    Arrival,
    Eye,
    LegacyCamera,
    LegacyMessage,
    Message,
    PictureOptions,
    Place,
    faces_of,
    given,
    light_of,
    sample_of,
    video_of,
)
from glsplat.rotations import FLIP_X, FLIP_Z, nearest_rotations
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import POSE_KEYS
from glsplat.tracking.sample import Sample

if TYPE_CHECKING:
    from glsplat.light.light import Light

__all__ = [
    "MAX_BYTES",
    "MAX_ID",
    "PARTS",
    "VERSION",
    "Ack",
    "Arrival",
    "Decoder",
    "Request",
    "WireOptions",
    "error_text",
    "eye_fields",
]

VERSION = 1
MAX_BYTES = 64 * 1024
"""Largest text message; a request with full hands is 2 to 4 kB."""

Form = Literal["native", "bundle-legacy", "single-legacy"]
MAX_ID = 2**32 - 1
PARTS = ("head",)
"""What a request may leave out of an avatar: the splats of the joint of that name and of all that hangs from it."""

_ORTHONORMAL = 1e-3  # largest entry of R R^T - I; float32 clients stay below 1e-6
_EXACT = ORTHONORMAL / 2  # beyond it the nearest rotation is taken: a place in a room rounds once more
LONGEST = 60_000.0
"""Milliseconds that an ``arrival`` may speak of."""
NEAREST = 1e-6  # metres; nearer than any near plane makes sense


@dataclass(frozen=True, slots=True, kw_only=True)
class WireOptions:
    """What a session accepts and what it fills in where a request is silent."""

    size: tuple[int, int] = (1024, 1024)  # pixels an eye
    max_side: int = 2048  # pixels
    quality: int = 80  # JPEG
    ipd: float = PAPER_IPD  # metres; for head poses without eyes
    fov: float = PAPER_FOV  # vertical degrees; likewise
    mirror: bool = False  # show the world reflected in x, as a mirror in front of the user does
    max_distance: float = 1e4  # metres from the origin for eyes and tracked points
    light: Light | None = None  # that the renderer lets fall on its scene where a request has none; clients are told


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Request:
    """One picture (of one or two eyes) that a client asks for, or how somebody stands (``poses``, without cameras).

    ``frame_id`` is None where an old client sent none.
    """

    frame_id: int | None
    cameras: tuple[Camera, ...]  # one or two, left first; none for poses
    pose: Pose | None = None  # None and no tracking: the rest pose
    tracking: Sample | None = None  # its time means nothing where ``t`` is None
    fault: str = ""  # why ``tracking`` cannot be solved, told when the picture is due
    t: float | None = None  # milliseconds of the client's clock as they came, echoed
    ack: int | None = None  # newest frame_id the client has received
    arrival: Arrival | None = None  # what it says of that
    options: PictureOptions = DEFAULT
    form: Form = "native"
    eyes: tuple[int, ...] = (0, 1)  # eye numbers of the cameras: 0 left, 1 right
    poses: bool = False  # the client draws
    datagrams: bool = False  # the client can have pictures by datagrams, too
    faces: tuple[Place, ...] = ()  # between the eyes of those whom a tracked avatar may look at, in its user's space


@dataclass(frozen=True, slots=True)
class Ack:
    """A message that only acknowledges: {"v": 1, "ack": 7}."""

    frame_id: int
    arrival: Arrival | None = None


_decoder = msgspec.json.Decoder(Message)
_legacy_decoder = msgspec.json.Decoder(LegacyMessage)
_encoder = msgspec.json.Encoder()


class Decoder:
    """Turns text into requests for one session.

    ``skeleton`` None means the 55 joints of SMPL-X; ``parts`` are those of the avatar that can be left out.
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
        """One message. Raises ProtocolError (code, and frame_id where it could be read) for anything malformed."""
        size = len(data) if isinstance(data, bytes) else len(data.encode("utf-8", "replace"))
        if size > MAX_BYTES:
            raise ProtocolError(f"a message needs at most {MAX_BYTES} bytes, not {size}", "too_big")
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
            asked = [name for name in PICTURE if getattr(m, name) not in (None, False)]
            if m.ack is None or asked:
                raise ProtocolError("a request needs frame_id" + (f" (found {', '.join(asked)})" if asked else ""))
            return Ack(m.ack, m.arrival)
        o = self.options
        if m.pose is not None and m.tracking is not None:
            raise ProtocolError("a request has either pose or tracking, not both")
        if m.want not in (None, "picture"):
            return self._poses(m)
        size = self._size(m.size)
        quality = o.quality if m.quality is None else m.quality
        if not 1 <= quality <= 100:
            raise ProtocolError("quality needs a whole number from 1 to 100")
        sample, fault = None, ""
        if m.tracking is not None:
            sample, fault = sample_of(m.tracking, (m.t or 0.0) / 1e3, o.max_distance)
        if m.eyes is not None:
            if not 1 <= len(m.eyes) <= 2:
                raise ProtocolError(f"eyes needs one or two entries, not {len(m.eyes)}")
            cameras = tuple(self._eye(eye, size) for eye in m.eyes)
        elif m.tracking is not None and m.tracking.head is not None:
            head = m.tracking.head
            cameras = stereo_cameras(_head(head[:3], head[3:]), o.ipd, o.fov, size=size)
        else:
            raise ProtocolError('a request needs "eyes": one or two of {"viewmat", "K"}')
        pose = None if m.pose is None else self._pose(given(m.pose))
        alpha, hide = _alpha(m.alpha), self._hidden(m.hide or [])
        return Request(
            frame_id=m.frame_id,
            cameras=_mirrored(cameras) if (o.mirror if m.mirror is None else m.mirror) else cameras,
            pose=pose,
            tracking=sample,
            fault=fault,
            t=m.t,
            ack=m.ack,
            arrival=m.arrival,
            options=PictureOptions(
                quality=quality,
                crop=m.crop,
                alpha=alpha,
                hide=hide,
                box=m.box,
                depth=m.depth,
                light=light_of(m.light),
                video=video_of(m.video),
            ),
            eyes=tuple(range(len(cameras))),
            datagrams=m.datagrams,
            faces=faces_of(m.faces, o.max_distance),
        )

    def _poses(self, m: Message) -> Request:
        """A request of a client that draws: what a picture would have to be like is not looked at."""
        if m.want != "pose":
            raise ProtocolError(f'want needs "picture" or "pose", not {m.want!r:.20}')
        sample, fault = None, ""
        if m.tracking is not None:
            sample, fault = sample_of(m.tracking, (m.t or 0.0) / 1e3, self.options.max_distance)
        pose = None if m.pose is None else self._pose(given(m.pose))
        return Request(
            frame_id=m.frame_id,
            cameras=(),
            pose=pose,
            tracking=sample,
            fault=fault,
            t=m.t,
            ack=m.ack,
            arrival=m.arrival,
            eyes=(),
            poses=True,
            faces=faces_of(m.faces, self.options.max_distance),
        )

    def _legacy(self, m: Message, old: LegacyMessage) -> Request:
        """Head poses in Unity's frame, both eyes alike; IPD, field of view and size are the server's."""
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
        smplx = {} if old.smplx is None else given(old.smplx)
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
        viewmat = np.array(eye.viewmat).reshape(4, 4)
        fx, fy, cx, cy = eye.K
        if not (max(abs(v) for v in eye.K) < 1e6 and min(fx, fy) > 1e-3):
            raise ProtocolError("K needs [fx, fy, cx, cy] in pixels below 1e6, fx and fy above 0.001", "bad_camera")
        rotation = viewmat[:3, :3]
        with np.errstate(all="ignore"):  # 1e300 is finite, its square is not
            off = np.abs(rotation @ rotation.T - np.eye(3)).max()
        if not off <= _ORTHONORMAL:
            raise ProtocolError("viewmat needs an orthonormal rotation (world to camera, row by row)", "bad_camera")
        if np.linalg.det(rotation) < 0:
            raise ProtocolError('viewmat is a reflection; for a mirror picture send "mirror": true', "bad_camera")
        if not NEAREST <= eye.near < eye.far <= FAR:
            raise ProtocolError(f"an eye needs {NEAREST:g} <= near < far <= {FAR:g} (metres)", "bad_camera")
        if not 0 <= eye.sh_degree <= SH_DEGREE:
            raise ProtocolError(f"sh_degree needs a whole number from 0 to {SH_DEGREE}", "bad_camera")
        if off > _EXACT:  # the same eye looks from there, by the nearest rotation
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
        """Which parts are left out; those of the avatar that is shown, no others."""
        for part in parts:
            if part not in PARTS:
                raise ProtocolError(f"hide knows {', '.join(PARTS)}; found another word")
            if part not in self.parts:
                raise ProtocolError(f'"hide": ["{part}"] needs one avatar that has a joint of that name')
        return tuple(sorted(set(parts)))

    def _pose(self, pose: Mapping[str, Any]) -> Pose:
        return Pose.from_smplx(pose) if self.skeleton is None else Pose.from_json(pose, self.skeleton)


def _mirrored(cameras: Sequence[Camera]) -> tuple[Camera, ...]:
    """The same eyes in a world reflected in x."""
    return tuple(
        Camera(c.viewmat @ FLIP_X, c.K, c.width, c.height, c.background, c.near, c.far, c.sh_degree, c.name)
        for c in cameras
    )


def eye_fields(camera: Camera) -> dict[str, Any]:
    """{"viewmat": 16 numbers, "K": [fx, fy, cx, cy]} of a camera, as requests and replies carry it.

    near, far (metres) and sh_degree are there where they are not the default.
    """
    k = camera.K
    fields: dict[str, Any] = {
        "viewmat": camera.viewmat.ravel().tolist(),
        "K": [float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])],
    }
    for name, default in (("near", NEAR), ("far", FAR), ("sh_degree", SH_DEGREE)):
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
            raise ProtocolError("arrival needs ack, which says of what picture it is")
        if not all(0 <= ms <= LONGEST for ms in (m.arrival.age, m.arrival.held)):
            raise ProtocolError(f"arrival needs milliseconds from 0 to {LONGEST:g} in age and held")


def error_text(code: str, message: str, frame_id: int | None = None) -> str:
    """The text message that tells a client what was wrong."""
    return _encoder.encode({"error": {"code": code, "message": _line(message), "frame_id": frame_id}}).decode()


def _head(position: Sequence[float], rotation: Sequence[float]) -> NDArray[np.float64]:
    """T_W_H [4, 4]. Raises FormatError or ProtocolError for what is no quaternion."""
    if max(map(abs, rotation)) > 1e3:  # 1e300 is finite, its square is not
        raise ProtocolError("a quaternion needs numbers of about unit length", "bad_camera")
    return head_matrix(position, rotation)


def _head_from_unity(head: LegacyCamera) -> NDArray[np.float64]:
    """T_W_H [4, 4] from Unity's left-handed frame: position S_x p, rotation S_x R S_z (docs/conventions.md)."""
    unity = _head((head.pos_x, head.pos_y, head.pos_z), (head.rot_x, head.rot_y, head.rot_z, head.rot_w))
    return FLIP_X @ unity @ FLIP_Z


def _safe_id(frame_id: int | None) -> int | None:
    return frame_id if frame_id is not None and 0 <= frame_id <= MAX_ID else None


def _line(message: str) -> str:
    """One printable line of bounded length: parts of it may come from the peer."""
    return "".join(c if c.isprintable() else " " for c in message[:300])
