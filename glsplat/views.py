"""Default views of a scene: an eye point that shows all of it, and the cameras there."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import splats_of
from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
from glsplat.meshes import RiggedMesh
from glsplat.rotations import FLIP_YZ
from glsplat.scene import Item, Scene, SceneLike
from glsplat.skinning.pose import Pose

__all__ = ["box_of", "orbited", "view_of", "viewing_point"]


def viewing_point(scene: SceneLike, fov: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (eye, target), seen from the front (+z), that show 98 % of the points of each visible item."""
    scene = Scene.of(scene)
    boxes = [box for item in scene if item.visible and (box := box_of(item)) is not None]
    if not boxes:
        return np.array([0.0, 0.0, 1.0]), np.zeros(3)
    corners = np.array([corner for box in boxes for corner in product(*box.T)])
    corners = corners @ scene.transform[:3, :3].T + scene.transform[:3, 3]
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre, half = (low + high) / 2, max(float((high - low).max()) / 2, 1e-3)
    distance = half * 1.25 / np.tan(np.radians(fov) / 2) + float(high[2] - low[2]) / 2
    return centre + np.array([0, 0, distance]), centre


def orbited(eye: NDArray[np.float64], target: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Return ``eye`` [3] rotated about the vertical axis through ``target`` [3] by ``angle`` radians, +z to +x."""
    x, y, z = eye - target
    return target + np.array([x * np.cos(angle) + z * np.sin(angle), y, z * np.cos(angle) - x * np.sin(angle)])


def box_of(item: Item) -> NDArray[np.float64] | None:
    """Return the bounds [2, 3] (lowest, highest) of 98 % of an item's points in its scene; None if it is empty.

    A mesh is posed. An avatar is in its bind pose, moved by ``trans``, because its splats are posed on the GPU.
    """
    if isinstance(item.content, RiggedMesh):
        # the bind pose of a file may have another size than its rest pose
        points = item.content.posed(item.pose or Pose.zero(len(item.content.skeleton)))
    else:
        splats = splats_of(item.content)
        points = splats.means[splats.finite()].astype(np.float64)
        if item.pose is not None:
            points = points + item.pose.trans
    if not len(points):
        return None
    if not np.array_equal(item.transform, np.eye(4)):
        points = points @ item.transform[:3, :3].T + item.transform[:3, 3]
    return np.asarray(np.percentile(points, (1, 99), axis=0), np.float64)


def view_of(
    eye: NDArray[np.float64],  # [3]
    target: NDArray[np.float64],  # [3]
    pixels: tuple[int, int],
    fov: float,
    ipd: float | None = None,  # a stereo pair with this distance between the eyes
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> list[Camera]:
    """Return a camera, or the two eyes of a head, that looks from ``eye`` to ``target``."""
    viewmat = look_at(eye, target)
    if ipd is None:
        return [Camera(viewmat, pinhole(*pixels, fov), *pixels, background=background)]
    head = np.linalg.inv(FLIP_YZ @ viewmat)
    return list(stereo_cameras(head, ipd, fov, size=pixels, background=background))
