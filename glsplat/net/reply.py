"""Packs and parses replies: the binary messages with a picture of both eyes, or with poses (docs/protocol.md).

Little endian: "VR", u16 version, u32 frame_id, u8 count; for each eye u8 eye, u32 length, JPEG, and with alpha u32
length, grey JPEG; then u32 length and a JSON object. A reply with poses has no pictures; its poses (codec/body.py)
follow the object.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import msgspec
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.errors import ProtocolError
from glsplat.net.codec.body import PersonPose, unpack_bodies
from glsplat.net.codec.encoded import DepthGrid, read_grids
from glsplat.net.messages import VERSION

_HEAD = struct.Struct("<2sHIB")
_EYE = struct.Struct("<BI")
_LENGTH = struct.Struct("<I")
_JPEG = b"\xff\xd8"  # its first bytes


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Reply:
    """One parsed reply: JPEG bytes by eye number (0 left, 1 right) and the JSON part."""

    frame_id: int
    pictures: dict[int, bytes]
    info: dict[str, Any] = field(default_factory=dict)
    nbytes: int = 0  # of the whole message
    alphas: dict[int, bytes] = field(default_factory=dict)  # grey JPEGs of the accumulated alpha, if requested
    bodies: tuple[PersonPose, ...] = ()  # of a reply with poses: those that changed
    depth: tuple[DepthGrid, ...] = ()  # one an eye, if requested
    video: tuple[NDArray[np.uint8], ...] = ()  # decoded eyes [H, W, 3 or 4] of a picture of a video

    def __repr__(self) -> str:
        eyes = ", ".join(f"eye {eye}: {len(jpeg)} bytes" for eye, jpeg in sorted(self.pictures.items())) or "no picture"
        eyes = f"{len(self.bodies)} bodies" if self.info.get("want") == "pose" else eyes
        return f"Reply(frame {self.frame_id}, {eyes})"

    @property
    def box(self) -> NDArray[np.float64] | None:
        """The avatar's lowest and highest corner [2, 3] in metres in the client's room; None if not requested."""
        corners = self.info.get("box")
        if corners is None:
            return None
        try:
            return np.array(corners, np.float64).reshape(2, 3)
        except (TypeError, ValueError):
            raise ProtocolError(f"{self!r}: expected a box of six numbers", "bad_reply") from None

    def decoders(self) -> list[Callable[[], NDArray[np.uint8]]]:
        """Return a function for each eye, left first, that decodes its picture; they may run on several threads."""
        return self._decoders(self.pictures, "RGB")

    def images(self) -> list[NDArray[np.uint8]]:
        """Return the decoded pictures [H, W, 3], left first; cropped ones are put back in place on black."""
        return [decode() for decode in self.decoders()]

    def rgba(self) -> list[NDArray[np.uint8]]:
        """Return the decoded pictures with alpha [H, W, 4], left first; colours are premultiplied (over black).

        Over a background they are colour + (1 - alpha) * background. Raises ProtocolError if alpha was not requested.
        """
        images = self.images()
        flat = any(eye.shape[2] < 4 for eye in self.video)
        if flat or not (self.video or self.pictures.keys() <= self.alphas.keys()):
            raise ProtocolError(f"{self!r} has no alpha: ask for it with alpha=True", "bad_reply")
        greys = [eye[..., 3:] for eye in self.video] or [one() for one in self._decoders(self.alphas, "GRAY")]
        if self.info.get("alpha") == "straight":
            images = [_multiplied(image, grey) for image, grey in zip(images, greys, strict=True)]
        return [np.concatenate(pair, axis=2) for pair in zip(images, greys, strict=True)]

    def _decoders(self, jpegs: dict[int, bytes], space: str) -> list[Callable[[], NDArray[np.uint8]]]:
        if self.video:
            return [partial(np.ascontiguousarray, eye[..., :3]) for eye in self.video]
        if "video" in self.info:
            raise ProtocolError(f"{self!r}: a video frame whose reference frame did not arrive", "lost")
        eyes = sorted(self.pictures)
        boxes = dict(zip(eyes, self.info.get("crop") or (), strict=False))
        size = self.info.get("size")
        return [partial(decode_picture, jpegs[eye], boxes.get(eye), size, space) for eye in eyes]


def pack_reply(
    frame_id: int,
    eyes: Sequence[int],
    pictures: Sequence[bytes],
    info: Mapping[str, Any],
    alphas: Sequence[bytes] | None = None,
    depth: Sequence[bytes] = (),
) -> bytes:
    """Return the message of one frame with all its eyes."""
    parts = [_HEAD.pack(b"VR", VERSION, frame_id, len(eyes))]
    for index, (eye, picture) in enumerate(zip(eyes, pictures, strict=True)):
        parts += [_EYE.pack(eye, len(picture)), picture]
        if alphas is not None:
            parts += [_LENGTH.pack(len(alphas[index])), alphas[index]]
    text = msgspec.json.encode(info)
    return b"".join([*parts, _LENGTH.pack(len(text)), text, *depth])


def pack_poses(frame_id: int, info: Mapping[str, Any], bodies: Sequence[bytes]) -> bytes:
    """Return the message of a reply with poses: up to 255 packed ``bodies``."""
    return b"".join([pack_reply(frame_id, (), (), info), bytes((len(bodies),)), *bodies])


def pack_single(eye: int, picture: bytes) -> bytes:
    """Return the message of one eye in the oldest form: u8 eye and the JPEG."""
    return bytes((eye,)) + picture


def parse_reply(data: bytes) -> Reply:
    """Parse a reply. Raises ProtocolError where it is incomplete or of another version."""
    try:
        magic, version, frame_id, count = _HEAD.unpack_from(data)
        if magic != b"VR" or version != VERSION:
            raise ProtocolError(f"expected a reply VR version {VERSION}, not {magic!r} {version}", "bad_reply")
        offset, pictures, alphas = _HEAD.size, {}, {}
        for _ in range(count):
            eye, length = _EYE.unpack_from(data, offset)
            offset += _EYE.size
            pictures[eye] = _take(data, offset, length)
            offset += length
            # without alpha these bytes are of the next picture's length or of the object's "{", never JPEG's
            if data[offset + 4 : offset + 6] == _JPEG:
                (length,) = _LENGTH.unpack_from(data, offset)
                alphas[eye] = _take(data, offset + _LENGTH.size, length)
                offset += _LENGTH.size + length
        (length,) = _LENGTH.unpack_from(data, offset)
        info = msgspec.json.decode(_take(data, offset + _LENGTH.size, length))
        offset += _LENGTH.size + length
        if not isinstance(info, dict):
            raise ProtocolError("expected a JSON object after the pictures", "bad_reply")
    except (struct.error, msgspec.MsgspecError, UnicodeError, RecursionError):
        raise ProtocolError(f"expected a whole reply, found {len(data)} bytes that end early", "bad_reply") from None
    bodies = tuple(unpack_bodies(data[offset:])) if count == 0 and info.get("want") == "pose" else ()
    depth = _depth(info["depth"], data[offset:]) if "depth" in info else ()
    return Reply(frame_id, pictures, info, len(data), alphas, bodies, depth)


def decode_picture(
    jpeg: bytes, box: Sequence[int] | None = None, size: Sequence[int] | None = None, space: str = "RGB"
) -> NDArray[np.uint8]:
    """Decode a JPEG to [H, W, 3], or to [H, W, 1] with ``space`` GRAY. Raises ProtocolError.

    With ``box`` (x, y, w, h) and ``size`` (W, H) it is placed on black.
    """
    try:
        image: NDArray[np.uint8] = simplejpeg.decode_jpeg(jpeg, space)
    except ValueError as error:
        raise ProtocolError(f"a picture is not a JPEG ({error})", "bad_reply") from None
    if box is None or size is None:
        return image
    x, y, w, h = box
    out = np.zeros((size[1], size[0], image.shape[2]), np.uint8)
    out[y : y + h, x : x + w] = image[:h, :w]
    return out


def _multiplied(image: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return ((image.astype(np.uint16) * alpha + 127) // 255).astype(np.uint8)


def _depth(fields: Any, data: bytes) -> tuple[DepthGrid, ...]:
    try:
        return read_grids(fields, data)
    except (KeyError, TypeError, ValueError) as error:
        raise ProtocolError(f"the depth of a reply cannot be read: {error}", "bad_reply") from None


def _take(data: bytes, offset: int, length: int) -> bytes:
    part = data[offset : offset + length]
    if len(part) != length:
        raise struct.error
    return part
