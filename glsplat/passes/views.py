"""What a caller hands to render(): cameras, a pose, where images go, checked before anything is drawn."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from glsplat.arrays import flag, instance, number, own
from glsplat.camera import Camera
from glsplat.config import MAX_BIAS
from glsplat.errors import GlsplatError, PoseError
from glsplat.scene import Item, Scene
from glsplat.skinning.pose import Pose
from glsplat.watermark.mark import Mark

__all__ = [
    "checked_bias",
    "checked_depth",
    "checked_mark",
    "checked_order",
    "checked_out",
    "checked_pose",
    "checked_views",
    "checked_without",
]


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
    instance(pose, Pose, "render", PoseError, "make one of your values first")
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


def checked_depth(depth: bool, dtype: str) -> bool:
    """Whether depths are wanted. Raises GlsplatError for a target whose alpha is too coarse to divide them by."""
    if flag(depth, "depth", GlsplatError) and dtype == "f1":
        raise GlsplatError("depth needs a float target, 8 bits of alpha make it metres off; use target='16f' or '32f'")
    return bool(depth)


def checked_without(without: Collection[Item], scene: Scene) -> frozenset[int]:
    """The id() of each of these items. Raises GlsplatError for what is no Item."""
    if isinstance(without, (Item, str, np.ndarray)) or not isinstance(without, Collection):
        raise GlsplatError(f"without needs a list of Items, not {type(without).__name__}; write without=[item]")
    found = frozenset(map(id, without))
    if not found:
        return found
    if strange := [item for item in without if not isinstance(item, Item)]:
        raise GlsplatError(f"without needs a list of Items, this one holds {type(strange[0]).__name__}")
    if found - set(map(id, scene.items)):
        raise GlsplatError("without names an item that is not in the scene; leave it out, or add it first")
    return found


def checked_out(out: NDArray[Any] | None, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """``out``, or a new array if there is none. Raises GlsplatError where images of ``shape`` cannot be put into it."""
    if out is None:
        return np.empty(shape, dtype)
    if not isinstance(out, np.ndarray):
        raise GlsplatError(f"out needs a contiguous array {shape} of {np.dtype(dtype)}, not {type(out).__name__}")
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
