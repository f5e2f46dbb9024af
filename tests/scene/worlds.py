"""Scenes of several things, and the float64 picture of one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.extras.authoring.geometry.raster import mesh_picture_and_depth
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.scene import Scene
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton

STANDING = Skeleton.from_joints(("root",), [-1], [[0.0, 0, 0]])


def wall(corners: NDArray[np.floating], colour: tuple[int, int, int]) -> RiggedMesh:
    """A rectangle of one colour: four corners [4, 3] in turn."""
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    texture = np.full((2, 2, 4), (*colour, 255), np.uint8)
    part = MeshPart("wall", faces, np.full((2, 3, 2), 0.5), texture)
    return RiggedMesh(np.asarray(corners, float), STANDING, np.zeros((4, 1), np.int64), np.ones((4, 1)), (part,))


def upright(x: float, half: float, colour: tuple[int, int, int]) -> RiggedMesh:
    """A wall in the plane of y and z at ``x``, seen edge on by nobody who stands in front."""
    corners = [[x, -half, -half], [x + 0.02, -half, half], [x + 0.02, half, half], [x, half, -half]]
    return wall(np.array(corners), colour)


def reference_of(
    scene: Scene, cameras: Sequence[Camera], config: RenderConfig | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Images [V, H, W, 4] and expected depths [V, H, W] of the concatenated scene."""
    config = config or RenderConfig()
    parts = []
    for item in scene:
        content = item.content
        if not item.visible or isinstance(content, RiggedMesh):
            continue
        if isinstance(content, Avatar):
            pose = item.pose or Pose.zero(len(content.skeleton))
            skin = content.skin
            if config.debug.influences:
                skin = skin.reduced(config.debug.influences).anchored(content.skeleton.parents)
            posed = reference.skin(content.splats, skin, pose.bones(content.skeleton), config.debug.rotation)
            parts.append((reference.placed(posed, item.transform), content.splats))
        else:
            parts.append((reference.placed(reference.rest(content), item.transform), content))
    return reference.render_scene(parts, cameras, [ground_of(scene, camera) for camera in cameras], config)


def ground_of(scene: Scene, camera: Camera) -> reference.MeshLayer:
    """The visible meshes under one camera, by the rasterizer in numpy."""
    colours, z = np.zeros((camera.height, camera.width, 3)), np.full((camera.height, camera.width), np.inf)
    for item in scene:
        if item.visible and isinstance(item.content, RiggedMesh):
            vertices = item.content.posed(item.pose or Pose.zero(len(item.content.skeleton)))
            vertices = vertices @ item.transform[:3, :3].T + item.transform[:3, 3]
            picture, depth = mesh_picture_and_depth(item.content, vertices, camera, 1)
            nearer = depth < z
            z[nearer], colours[nearer] = depth[nearer], picture[nearer][:, :3]
    return reference.MeshLayer(colours, z)


def random_pose(joints: int, seed: int, size: float = 0.3) -> Pose:
    rng = np.random.default_rng(seed)
    return Pose(rng.normal(0, size, (joints, 3)), rng.normal(0, 0.05, 3))
