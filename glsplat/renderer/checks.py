"""Checks of the arguments of render(), before anything is drawn."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.gl.context import Context
from glsplat.skinning.pose import Pose

__all__ = [
    *("Depths", "Images", "Pixel", "Views"),
    *("check_driver", "checked_out", "checked_pose", "checked_views"),
]

if TYPE_CHECKING:
    import typing_extensions

    Pixel = typing_extensions.TypeVar("Pixel", np.uint8, np.float32, default=np.uint8)
else:
    Pixel = TypeVar("Pixel", np.uint8, np.float32)
"""Type of images (``RenderConfig.output``). Type checkers take it from ``out`` or the variable, else uint8."""

Views = Iterable[Camera]
Images = NDArray[Any]
"""[V, H, W, 4] uint8 or float32."""
Depths = NDArray[np.float32]
"""[V, H, W] metres."""


def check_driver(config: RenderConfig, context: Context) -> None:
    """Raise ContextError if the driver lacks a feature that the config requires."""
    driver = context.driver
    if config.debug.layers == "vertex" and not context.vertex_layers:
        raise ContextError(f"{driver} cannot write gl_Layer in the vertex shader; use layers='geometry'")
    if config.sorter == "gpu" and not context.compute:
        raise ContextError(f"the GPU sorter needs OpenGL 4.3, this is {driver}; use sorter='cpu'")
    if config.debug.fetch == "storage" and not context.vertex_storage:
        raise ContextError(f"{driver} has no storage buffers in the vertex shader; use fetch='attributes'")


def checked_views(cameras: Views, size: tuple[int, int], what_to_do: str = "") -> list[Camera]:
    """Return the cameras as a list: at least one, all of ``size`` (width, height). Raises GlsplatError."""
    if isinstance(cameras, Camera):
        raise GlsplatError("render needs a list of cameras, not one Camera; write render([camera])")
    try:
        views = list(cameras)
    except TypeError:
        raise GlsplatError(f"render needs a list of cameras, not {type(cameras).__name__}") from None
    if not views:
        raise GlsplatError("render needs at least one camera")
    for view in views:
        if not isinstance(view, Camera):
            raise GlsplatError(f"render needs a list of glsplat.Camera, this one holds {type(view).__name__}")
    if any((view.width, view.height) != size for view in views):
        raise GlsplatError(f"cameras need the renderer's size {size[0]}x{size[1]}{what_to_do}")
    if len({view.layers for view in views}) > 1:
        raise GlsplatError("the views of one call need the same layers; call render() once for each")
    return views


def checked_pose(pose: Pose | None, joints: int, what: str) -> Pose:
    """Return the pose, or the zero pose for None. Raises PoseError if ``what`` has another number of ``joints``."""
    if pose is None:
        return Pose.zero(joints)
    if len(pose.rotations) != joints:
        raise PoseError(f"the pose has {len(pose.rotations)} joints, the {what} {joints}")
    return pose


def checked_out(out: Images | None, shape: tuple[int, ...], dtype: DTypeLike) -> Images:
    """Return ``out``, or a new array for None. Raises GlsplatError if ``out`` cannot hold images of ``shape``."""
    if out is None:
        return np.empty(shape, dtype)
    if not isinstance(out, np.ndarray):
        raise GlsplatError(f"out needs a contiguous array {shape} of {np.dtype(dtype)}, not {type(out).__name__}")
    if out.shape != shape or out.dtype != dtype or not (out.flags.c_contiguous and out.flags.writeable):
        raise GlsplatError(f"out needs a contiguous array {shape} of {np.dtype(dtype)}, not {out.shape} {out.dtype}")
    return out
