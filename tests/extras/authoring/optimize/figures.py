"""A ball to fit splats to, and the PSNR of pictures of it."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.extras.authoring.geometry.raster import mesh_picture
from glsplat.extras.authoring.sample.surface import SamplerConfig, make_avatar
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from tests.extras.authoring.sample.test_surface import ball, rigged

__all__ = ["HELD_OUT", "camera_at", "decibel", "kept", "mesh", "start"]

HELD_OUT = ((0.0, 1.0, 1.5), (1.3, 1.5, -0.4), (-0.6, 0.4, 1.0))
"""Camera positions that no fit uses."""


@cache
def mesh() -> RiggedMesh:
    """Return a ball on two joints in smooth colours that continue across the seam of the texture."""
    v, u = np.mgrid[:64, :64] / 64
    texture = np.full((64, 64, 4), 255, np.uint8)
    texture[..., 0] = 40 + 180 * v
    texture[..., 1] = 128 + 90 * np.sin(2 * np.pi * u)
    texture[..., 2] = 128 + 90 * np.cos(4 * np.pi * u) * np.sin(np.pi * v)
    return rigged(ball(texture=texture))


@cache
def start(splats: int = 400) -> Avatar:
    """Return splats on the ball before any fit."""
    return make_avatar(mesh(), splats, 3, SamplerConfig(probe=128))


def camera_at(eye: tuple[float, float, float], size: int = 80) -> Camera:
    """Return a camera that looks at the ball."""
    return Camera(look_at(eye, (0, 1, 0)), pinhole(size, size, 30), size, size)


def decibel(picture: NDArray[np.floating], other: NDArray[np.floating]) -> float:
    """Return the PSNR, dB."""
    return float(-10 * np.log10(max(((picture.astype(np.float64) - other) ** 2).mean(), 1e-30)))


def kept(avatar: Avatar, pose: Pose | None = None) -> float:
    """Return the PSNR of the avatar against the ball from positions that no fit uses."""
    pose = pose or Pose.zero(2)
    splats, vertices = posed_splats(avatar, pose), mesh().posed(pose)
    cameras = [camera_at(eye) for eye in HELD_OUT]
    truth = np.stack([mesh_picture(mesh(), vertices, camera, 3) for camera in cameras])
    return decibel(np.stack([reference.render(splats, [camera])[0] for camera in cameras]), truth)
