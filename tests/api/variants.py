"""Renderers of every kind, small: what tests of contexts, threads and state take turns with."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import RenderConfig, with_fields
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.gl.context import Context
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats
from tests.scenes import cloud, eyes, limb

SIZE = 64
SOFTPIPE = os.environ.get("GALLIUM_DRIVER") == "softpipe"
VIEWS = eyes(SIZE)
BACK = Camera(look_at((0, 0, -3), (0, 0, 0)), pinhole(SIZE, SIZE), SIZE, SIZE)


def bent(joints: int = 4, angle: float = 0.7) -> Pose:
    return Pose(np.full((joints, 3), (0.1, 0.2, angle)), np.array([-0.8, -0.3, 0.1]))


def sheet() -> RiggedMesh:
    """A textured square on one joint."""
    rng = np.random.default_rng(5)
    vertices = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])[faces]
    part = MeshPart("sheet", faces, uv, rng.integers(0, 256, (16, 16, 4), np.uint8))
    skeleton = Skeleton.from_joints(("root",), np.array([-1]), np.zeros((1, 3)))
    return RiggedMesh(vertices, skeleton, np.zeros((4, 1), np.int64), np.ones((4, 1)), (part,))


def coned(count: int = 600) -> Splats:
    """Half of the splats hidden from any side."""
    return replace(cloud(count), cones=np.random.default_rng(2).integers(-128, 128, (count, 4)).astype(np.int8))


class Kind:
    """One kind of renderer and the picture it makes."""

    def __init__(self, name: str, make: Callable[..., Renderer | MeshTruth], pose: Pose | None, *views: Camera):
        self.name, self.make, self.pose, self.views = name, make, pose, views or VIEWS

    def draw(self, renderer: Renderer | MeshTruth) -> NDArray[Any]:
        return renderer.render(self.views, self.pose)


def splats(name: str, scene: Any, *views: Camera, pose: Pose | None = None, **config: Any) -> Kind:
    if SOFTPIPE:  # its texture cache keeps what a target held before, so 8 bits of a second picture are wrong there
        config["output"] = "float32"

    def make(context: Context | None = None) -> Renderer:
        return Renderer(
            scene, size=(SIZE, SIZE), views=2, config=with_fields(RenderConfig(), **config), context=context
        )

    return Kind(name, make, pose, *views)


def mesh(name: str, **config: Any) -> Kind:
    def make(context: Context | None = None) -> MeshTruth:
        return MeshTruth(sheet(), size=(SIZE, SIZE), **config, context=context)

    return Kind(name, make, None)


KINDS = [
    splats("plain", cloud()),
    splats("float", cloud(300, 3), output="float32", antialias=True),
    splats("half", cloud(400, 1), output="float32", target="16f", shape="quad"),
    splats("eight", cloud(200, 2), VIEWS[0], target="8", sort_bits=16),
    # softpipe ends at OpenGL 3.3: there it is the plain sorter again
    splats("gpu", cloud(2000), sorter="auto" if SOFTPIPE else "gpu"),
    splats("geometry", cloud(300, 2), layers="geometry", order="per_view"),
    splats("apart", cloud(300, 1), VIEWS[0], BACK, output="float32"),
    splats("hidden", coned(), cull_hidden=True),
    splats("limb", limb(), pose=bent()),
    splats("limb8", limb(influences=8, degree=3), pose=bent(angle=0.3), rotation="raw"),
    splats("limb1", limb(influences=1, degree=1), VIEWS[1], pose=bent(angle=0.1), output="float32"),
    mesh("mesh"),
    mesh("mesh float", samples=1, output="float32"),
]
