"""What a caller hands to render(): cameras and a pose, checked before anything is drawn."""

from __future__ import annotations

from collections.abc import Iterable

from glsplat.camera import Camera
from glsplat.errors import GlsplatError, PoseError
from glsplat.skinning.pose import Pose

__all__ = ["checked_pose", "checked_views"]


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
