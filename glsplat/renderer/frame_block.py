"""FrameBlock: cameras and settings of a frame, a std140 uniform block that mirrors shaders/frame.glsl."""

from __future__ import annotations

from collections.abc import Sequence

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.shaders.slots import FRAME_BLOCK

VIEW_DTYPE = np.dtype(
    [
        ("rows", np.float32, (3, 4)),
        ("intrinsics", np.float32, 4),
        ("limits", np.float32, 4),
        ("eye", np.float32, 4),
        ("background", np.float32, 4),
        ("range", np.float32, 4),
    ]
)


def frame_dtype(views: int) -> np.dtype[np.void]:
    """Return the numpy record of struct Frame; all members are vec4, so std140 adds no padding."""
    return np.dtype(
        [
            ("views", VIEW_DTYPE, (views,)),
            ("sort_row", np.float32, 4),
            ("size", np.float32, 4),
            ("knobs", np.float32, 4),
        ]
    )


class FrameBlock:
    """Owns the buffer. Cameras are composed in float64 about the scene's origin, then rounded to float32 once."""

    def __init__(self, ctx: moderngl.Context, views: int) -> None:
        self._record = np.zeros((), frame_dtype(views))
        self._written = b""
        self.buffer: moderngl.Buffer = ctx.buffer(reserve=self._record.nbytes, dynamic=True)

    def write(
        self,
        cameras: Sequence[Camera],
        sort_viewmat: NDArray[np.float64],  # [4, 4]
        origin: NDArray[np.float64],  # [3] world position of the scene's zero
        config: RenderConfig,
    ) -> None:
        """Fill the block for one batch of views and bind it."""
        record = self._record
        for view, camera in zip(record["views"], cameras, strict=True):
            R, t = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
            view["rows"][:, :3] = R
            view["rows"][:, 3] = R @ origin + t
            fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
            view["intrinsics"] = fx, fy, cx, cy
            mx, my = 0.15 * camera.width / fx, 0.15 * camera.height / fy
            view["limits"] = -cx / fx - mx, (camera.width - cx) / fx + mx, -cy / fy - my, (camera.height - cy) / fy + my
            view["eye"][:3] = camera.position - origin
            view["background"][:3] = camera.background
            view["range"][:2] = camera.near, camera.far
        record["sort_row"][:3] = sort_viewmat[2, :3]
        record["sort_row"][3] = sort_viewmat[2, :3] @ origin + sort_viewmat[2, 3]
        width, height = cameras[0].width, cameras[0].height
        record["size"] = width, height, 2 / width, 2 / height
        record["knobs"][:4] = config.debug.eps2d, config.max_sigma, 0.0, config.debug.cull_margin
        content = record.tobytes()
        if content != self._written:
            self.buffer.write(content)
            self._written = content
        self.buffer.bind_to_uniform_block(FRAME_BLOCK)

    def release(self) -> None:
        """Delete the buffer."""
        self.buffer.release()
