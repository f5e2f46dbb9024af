"""What a caller hands to render(): cameras, a pose, where images go, checked before anything is drawn."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from glsplat.arrays import number, own
from glsplat.camera import Camera
from glsplat.config import MAX_BIAS
from glsplat.errors import GlsplatError, PoseError
from glsplat.skinning.pose import Pose
from glsplat.watermark.mark import Mark

__all__ = ["checked_bias", "checked_mark", "checked_order", "checked_out", "checked_pose", "checked_views"]


def checked_views(cameras: Iterable[Camera], size: tuple[int, int], what_to_do: str = "") -> list[Camera]:
    """The cameras as a list: at least one, all of ``size`` (width, height). Raises GlsplatError."""
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
    return views


def checked_pose(pose: Pose | None, joints: int, what: str) -> Pose:
    """The pose, or the zero pose for none. Raises PoseError if it does not fit ``what`` has so many joints."""
    if pose is None:
        return Pose.zero(joints)
    if not isinstance(pose, Pose):
        raise PoseError(f"render needs a glsplat.Pose, not {type(pose).__name__}; make one of your values first")
    if len(pose.rotations) != joints:
        raise PoseError(f"the pose has {len(pose.rotations)} joints, the {what} {joints}")
    return pose


def checked_order(sort_viewmat: ArrayLike | None) -> NDArray[np.float64] | None:
    """The matrix [4, 4] whose third row orders the splats, or None. Raises GlsplatError for what is no such matrix."""
    if sort_viewmat is None:
        return None
    order = own(sort_viewmat, np.float64, "sort_viewmat", GlsplatError)
    if not (order.shape == (4, 4) and np.isfinite(order).all()):
        raise GlsplatError("sort_viewmat needs 4x4 finite numbers")
    return order


def checked_bias(lod_bias: float) -> float:
    """``lod_bias`` as a number. Raises GlsplatError for what is none, or too large."""
    lod_bias = number(lod_bias, "lod_bias", GlsplatError)
    if not -MAX_BIAS <= lod_bias <= MAX_BIAS:
        raise GlsplatError(f"lod_bias needs -{MAX_BIAS:g} to {MAX_BIAS:g}, not {lod_bias:g}")
    return lod_bias


def checked_out(out: NDArray[Any] | None, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """``out``, or a new array if there is none. Raises GlsplatError where images of ``shape`` cannot be put into it."""
    if out is None:
        return np.empty(shape, dtype)
    if out.shape != shape or out.dtype != dtype or not (out.flags.c_contiguous and out.flags.writeable):
        raise GlsplatError(f"out needs a contiguous array {shape} of {np.dtype(dtype)}, not {out.shape} {out.dtype}")
    return out


def checked_mark(mark: Mark, bytes_: bool) -> Mark:
    """The mark, which only 8-bit pictures carry. Raises GlsplatError."""
    if not isinstance(mark, Mark):
        raise GlsplatError(f"render needs a glsplat.watermark.mark.Mark, not {type(mark).__name__}")
    if not bytes_:
        raise GlsplatError("a mark is drawn into 8-bit pictures; use RenderConfig(output='uint8')")
    return mark
