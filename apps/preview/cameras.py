"""The preview's view: start options, a viewpoint that orbits and flies, and the cameras of each layout."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.camera import PAPER_FOV, PAPER_IPD, Camera, pinhole, stereo_cameras
from glsplat.config import RenderConfig
from glsplat.errors import FormatError
from glsplat.renderer.present import Layout, view_size
from glsplat.rotations import FLIP_YZ

_MAX_PITCH_RAD = np.pi / 2


@dataclass(frozen=True, kw_only=True)
class Options:
    """Start options of the preview."""

    layout: Layout = "mono"
    fov: float = PAPER_FOV
    ipd: float = PAPER_IPD
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    eye: tuple[float, float, float] | None = None
    target: tuple[float, float, float] | None = None
    numbers: bool = False  # show the overlay
    text_scale: float = 1.0
    rendering: RenderConfig = field(default_factory=RenderConfig)


@dataclass(frozen=True, eq=False)
class View:
    """Viewpoint that looks at ``target`` from ``distance`` metres; angles in radians, world y up.

    At yaw 0 the eye is on the target's +z side, in front of an avatar; yaw grows towards +x, pitch upwards.
    """

    target: NDArray[np.float64]  # [3]
    distance: float
    yaw: float = 0.0
    pitch: float = 0.0

    @classmethod
    def between(cls, eye: ArrayLike, target: ArrayLike) -> View:
        """Return the view from ``eye`` to ``target``. Raises FormatError if they are one point."""
        target = np.array(target, np.float64)
        x, y, z = np.asarray(eye, np.float64) - target
        distance = float(np.sqrt(x * x + y * y + z * z))
        if not distance > 0:
            raise FormatError("eye and target are the same point; move one of them")
        return cls(target, distance, float(np.arctan2(x, z)), float(np.arctan2(y, np.hypot(x, z))))

    @property
    def axes(self) -> NDArray[np.float64]:
        """Axes [3, 3], columns right, up, back (OpenGL); also defined straight up and down."""
        cy, sy, cp, sp = np.cos(self.yaw), np.sin(self.yaw), np.cos(self.pitch), np.sin(self.pitch)
        return np.array([[cy, -sy * sp, sy * cp], [0, cp, sp], [-sy, -cy * sp, cy * cp]])

    @property
    def eye(self) -> NDArray[np.float64]:
        """Position [3] in metres."""
        return self.target + self.distance * self.axes[:, 2]

    @property
    def head(self) -> NDArray[np.float64]:
        """T_W_H [4, 4]: the head pose between the two eyes."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.axes, self.eye
        return matrix

    def orbited(self, right: float, up: float) -> View:
        """Return the view with the eye rotated about the target by angles in radians, up to straight above or below."""
        pitch = float(np.clip(self.pitch + up, -_MAX_PITCH_RAD, _MAX_PITCH_RAD))
        return replace(self, yaw=(self.yaw + right) % (2 * np.pi), pitch=pitch)

    def looked(self, right: float, up: float) -> View:
        """Return the view with its direction rotated by angles in radians; the eye stays."""
        turned = self.orbited(-right, -up)
        return replace(turned, target=self.eye - self.distance * turned.axes[:, 2])

    def moved(self, right: float, up: float, forward: float) -> View:
        """Return the view with eye and target moved by metres along the eye's axes."""
        return replace(self, target=self.target + self.axes @ np.array([right, up, -forward]))

    def zoomed(self, factor: float, nearest: float = 1e-4, farthest: float = 1e7) -> View:
        """Return the view with its distance scaled, within bounds in metres."""
        return replace(self, distance=float(np.clip(self.distance * factor, nearest, farthest)))


def cameras_of(
    view: View,
    layout: Layout,
    window: tuple[int, int],  # pixels
    fov: float,  # vertical, degrees
    ipd: float,  # metres between the eyes
    background: tuple[float, float, float],
) -> list[Camera]:
    """Return the cameras that fill a window.

    Side by side has parallel axes, as in a headset. An anaglyph is viewed on a screen, so its frusta are shifted until
    the target has zero disparity.
    """
    size = view_size(window, layout)
    K = pinhole(*size, fov)
    if layout == "mono":
        viewmat = FLIP_YZ @ np.linalg.inv(view.head)
        return [Camera(viewmat, K, *size, background=background)]
    ks = np.stack([K, K])
    if layout == "anaglyph":
        shift = ipd / 2 * K[0, 0] / view.distance
        ks[:, 0, 2] += (-shift, shift)
    return list(stereo_cameras(view.head, ipd, fov, ks, size, background))
