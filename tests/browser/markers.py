"""A backend that draws blobs at known places of the user's room, exactly, in numpy: geometry without a renderer."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.data import default_avatar
from glsplat.net.backend import AvatarInfo, Rendered, RenderJob, Solved
from glsplat.net.messages import Request
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats
from glsplat.tracking.sample import Sample

__all__ = ["COLOURS", "Markers", "as_tracked", "draw_blob", "marked_avatar", "offered", "samples"]

COLOURS = {"red": (255, 0, 0), "green": (0, 255, 0), "blue": (0, 0, 255), "white": (255, 255, 255)}
Places = Mapping[str, ArrayLike]


class Markers:
    """Blobs of ``radius`` metres (a standard deviation) where ``places(request)`` says: {colour: [x, y, z]}.

    Every request is kept in ``requests``; a picture takes ``delay`` seconds.
    """

    def __init__(self, places: Callable[[RenderJob], Places], radius: float = 0.015, delay: float = 0.0) -> None:
        self._places = places
        self._radius = radius
        self.delay = delay
        self.requests: list[RenderJob] = []

    def open(self) -> str:
        return "blobs"

    def render(self, request: RenderJob) -> Rendered:
        end = time.monotonic() + self.delay
        self.requests.append(request)
        camera = request.cameras[0]
        images = np.zeros((len(request.cameras), camera.height, camera.width, 4), np.uint8)
        for eye, camera in enumerate(request.cameras):
            for colour, place in self._places(request).items():
                draw_blob(images[eye], camera, np.asarray(place, float), self._radius, COLOURS[colour])
        time.sleep(max(0.0, end - time.monotonic()))
        return Rendered(images, {"total": 0.0})

    def close(self) -> None: ...

    def asked(self, frame_id: int) -> RenderJob:
        """Return the newest request of that number, which each connection counts by itself."""
        return next(one for one in reversed(self.requests) if one.frame_id == frame_id)


def draw_blob(
    image: NDArray[np.uint8], camera: Camera, place: NDArray[np.float64], radius: float, colour: tuple[int, int, int]
) -> None:
    """Over ``image`` [H, W, 4], premultiplied; nothing where the place is behind the camera or outside."""
    x, y, z = camera.viewmat[:3, :3] @ place + camera.viewmat[:3, 3]
    if z < camera.near:
        return
    middle = np.array([camera.K[0, 0] * x / z + camera.K[0, 2], camera.K[1, 1] * y / z + camera.K[1, 2]])
    sigma = radius / z * np.array([camera.K[0, 0], camera.K[1, 1]])
    limits = (camera.width, camera.height)
    low = [int(np.clip(np.floor(m - 4 * s), 0, n)) for m, s, n in zip(middle, sigma, limits, strict=True)]
    high = [int(np.clip(np.ceil(m + 4 * s), 0, n)) for m, s, n in zip(middle, sigma, limits, strict=True)]
    fall = [np.exp(-0.5 * ((np.arange(a, b) + 0.5 - m) / s) ** 2)
            for a, b, m, s in zip(low, high, middle, sigma, strict=True)]  # fmt: skip
    alpha = (fall[1][:, None] * fall[0])[..., None]
    part = image[low[1] : high[1], low[0] : high[0]]
    part[:] = np.round(alpha * np.array([*colour, 255]) + (1 - alpha) * part).astype(np.uint8)


samples: dict[int, Sample] = {}
"""By frame_id, what pages have sent of a user: their renderers are told poses alone."""


class _AsTracked:
    """A solver that leaves cameras where they are."""

    def solve(self, request: Request, now: float) -> Solved:
        assert request.frame_id is not None and request.tracking is not None
        samples[request.frame_id] = request.tracking
        return Solved(Pose(np.zeros((55, 3))))


def as_tracked(height: float | None, span: float | None) -> _AsTracked:
    return _AsTracked()


offered = (AvatarInfo(name="markers", solver=as_tracked, height=1.75, parts=frozenset({"head"})),)
"""What a server of Markers offers: one avatar that can be tracked."""


def marked_avatar(radius: float = 0.012) -> Avatar:
    """The embedded rig with nothing on it but red at the right wrist, green at the left one, blue before the mouth."""
    skeleton = default_avatar().skeleton
    joints = [skeleton.names.index(name) for name in ("right_wrist", "left_wrist", "head")]
    splats = Splats.create(
        skeleton.joints[joints] + [[0, 0, 0], [0, 0, 0], [0, -0.05, 0.25]],
        [[1, 0, 0, 0]] * 3,
        np.full((3, 3), radius),
        [0.99] * 3,
        rgb=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    )
    return Avatar(splats, skeleton, Skin([[joint] for joint in joints], [[1.0]] * 3))
