"""Test contract scenes on every path of the renderer against float64, at the gates of docs/conventions.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from glsplat import reference
from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.camera import Camera, stereo_cameras
from glsplat.config import RenderConfig, with_fields
from glsplat.extras.evaluate.difference import Difference
from glsplat.extras.evaluate.stability.frame import Case, Outcome, cloud
from glsplat.extras.evaluate.stability.skin import chain, expressive
from glsplat.gl.context import Context
from glsplat.light.light import Light
from glsplat.light.surface import Surface
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats

MIN_PSNR_16F = 50.0  # dB; also of 8-bit pictures
MAX_MEAN_DEPTH_ERROR_M = 1e-4  # at 3 m
_SIZE = (96, 64)
_WALL_EDGE_X = 0.137  # metres; no pixel centre of the views is within 0.1 pixels of it
_WALL_COLOUR = (200, 60, 20)
_DISTANCE = 3.0  # metres from the left eye to the plane z = 0
_NEARER_M = 0.05  # by which the right eye is nearer


@dataclass(frozen=True)
class RenderPath:
    """One combination of the alternatives from which a renderer chooses by its driver."""

    shape: str = "quad"
    fetch: str = "attributes"
    target: str = "32f"
    sorter: str = "cpu"
    views: int = 1
    layers: str = "auto"

    def __str__(self) -> str:
        routed = ", geometry shader" if self.layers == "geometry" else ""
        views = "one view" if self.views == 1 else f"{self.views} views"
        return f"{self.shape}s, {self.fetch}, {self.target}, {self.sorter} sorter, {views}{routed}"

    def config(self, output: str) -> RenderConfig:
        """Return the settings that force this path."""
        forced = {key: value for key, value in vars(self).items() if key != "views"}
        return with_fields(RenderConfig(), output=output, **forced)


class _World(NamedTuple):
    """A scene with its posed splats for the reference."""

    scene: Scene
    posed: reference.Posed
    splats: Splats
    wall: bool = False
    output: str = "float32"


@dataclass(frozen=True)
class ContractScene:
    """A scene with any number of splats, so that a failure can be reduced."""

    name: str
    splats: int
    make: Callable[[int], _World]


def paths_of(context: Context) -> list[RenderPath]:
    """Return every path that the driver supports, the simplest first."""
    axes = (
        ("quad", "triangle"),
        ("attributes", "storage") if context.vertex_storage else ("attributes",),
        ("32f", "16f"),
        ("cpu", "gpu") if context.compute else ("cpu",),
        (1, 2),
    )
    return [*(RenderPath(*choice) for choice in product(*axes)), RenderPath(views=2, layers="geometry")]


def contract_cases(context: Context, quick: bool) -> list[Case]:
    """Return a case for each scene on each path; ``quick``: every fifth path, another fifth for the next scene."""
    paths = paths_of(context)
    return [
        Case("contract", scene.name, f"{scene.splats} splats; {path}", _gate(path, scene), _check(scene, path))
        for index, scene in enumerate(SCENES)
        for path in (paths[index % 5 :: 5] if quick else paths)
    ]


def _gate(path: RenderPath, scene: ContractScene) -> str:
    exact = path.target == "32f" and scene.make(0).output == "float32"
    return "65 dB, largest error 0.06" if exact else f"{MIN_PSNR_16F:g} dB"


def _check(scene: ContractScene, path: RenderPath) -> Callable[[Context], Outcome]:
    def check(context: Context) -> Outcome:
        outcome = _tried(context, scene, path, scene.splats)
        if outcome.held:
            return outcome
        counts = [2**k for k in range(scene.splats.bit_length()) if 2**k < scene.splats]
        fewest = next((n for n in counts if not _tried(context, scene, path, n).held), scene.splats)
        return replace(outcome, splats=fewest, seen=f"{outcome.seen}; fails with {fewest} splats")

    return check


def _tried(context: Context, scene: ContractScene, path: RenderPath, count: int) -> Outcome:
    try:
        return _drawn(context, scene, path, count)
    except Exception as error:  # whatever the driver raises
        return Outcome(False, None, seen=f"{type(error).__name__}: {error}")


def _drawn(context: Context, scene: ContractScene, path: RenderPath, count: int) -> Outcome:
    """Draw the views before and after other views; the pictures have to be equal, and within the gate of float64."""
    world, views = scene.make(count), _views(_DISTANCE)[: path.views]
    elsewhere = _views(_DISTANCE - 0.4)[: path.views]
    config = path.config(world.output)
    with Renderer(world.scene, size=_SIZE, views=path.views, config=config, context=context) as renderer:
        first = renderer.render(views)
        renderer.render(elsewhere)
        image, depth = renderer.render(views, depth=True)
    expected, expected_depth = _expected(scene, count, path.views)
    exact = path.target == "32f" and world.output == "float32"
    if world.output == "uint8":
        expected = np.clip(expected, 0, 1)
    error = Difference.of(image, expected, flip=False)
    seen = expected[..., 3] > 0.01  # depth is divided by alpha
    off = float(np.abs(depth - expected_depth)[seen].mean()) if seen.any() else 0.0
    faults = [
        *(["not the bytes of the first time"] if not np.array_equal(first, image) else []),
        *([f"depth off by {off:.1e} m"] if not off <= MAX_MEAN_DEPTH_ERROR_M else []),
    ]
    held = (error.contract if exact else error.psnr >= MIN_PSNR_16F) and not faults
    return Outcome(held, error.maximum, "of 1", "; ".join([f"{error.psnr:.1f} dB", *faults]))


def _views(distance: float) -> list[Camera]:
    head = np.eye(4)
    head[2, 3] = distance
    left, right = stereo_cameras(head, 0.2, size=_SIZE, background=(0.1, 0.3, 0.2))
    nearer = right.viewmat.copy()
    nearer[2, 3] -= _NEARER_M  # the eyes differ in depth, too
    return [left, replace(right, viewmat=nearer)]


@lru_cache(maxsize=4)
def _expected(scene: ContractScene, count: int, views: int) -> tuple[F64, F64]:
    """Return images [V, H, W, 4] and depths [V, H, W] in float64."""
    world, cameras = scene.make(count), _views(_DISTANCE)[:views]
    meshes = [_wall_seen(camera) for camera in cameras] if world.wall else None
    return reference.render_scene([(world.posed, world.splats)], cameras, meshes, light=world.scene.light)


def _wall_seen(camera: Camera) -> reference.MeshLayer:
    """Return the wall at z = 0 left of ``_WALL_EDGE_X``, as seen by a camera that looks along -z."""
    z = camera.position[2]
    x = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0] * z + camera.position[0]
    hit = np.broadcast_to(x < _WALL_EDGE_X, (camera.height, camera.width))
    colours = np.broadcast_to(np.array(_WALL_COLOUR) / 255, (*hit.shape, 3))
    return reference.MeshLayer(colours, np.where(hit, z, np.inf))


def _wall() -> RiggedMesh:
    corners = np.array([[-9.0, -9, 0], [_WALL_EDGE_X, -9, 0], [_WALL_EDGE_X, 9, 0], [-9, 9, 0]])
    faces, texture = np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.full((2, 2, 4), (*_WALL_COLOUR, 255), np.uint8)
    part = MeshPart("wall", faces, np.full((2, 3, 2), 0.5), texture)
    standing = Skeleton.from_joints(("root",), [-1], [[0.0, 0, 0]])
    return RiggedMesh(corners, standing, np.zeros((4, 1), np.int64), np.ones((4, 1)), (part,))


def _still(splats: Splats, light: Light | None = None, **more: Any) -> _World:
    return _World(Scene([Item(splats)], light=light), reference.rest(splats), splats, **more)


def _posed(avatar: Avatar, expression: float = 0.0) -> _World:
    names = avatar.shapes.names if avatar.shapes is not None else ()
    pose = Pose(np.full((12, 3), (0.1, 0.2, 0.3)), np.array([-0.3, 0, 0]), expression=dict.fromkeys(names, expression))
    bones, weights = pose.bones(avatar.skeleton), avatar.weights(pose)
    posed = reference.skin(avatar.splats, avatar.skin, bones, shapes=avatar.shapes, expression=weights)
    return _World(Scene([Item(avatar, pose=pose)]), posed, avatar.splats)


def _lit(count: int) -> _World:
    rng, splats = np.random.default_rng(4), cloud(count)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    surface = Surface.of(normals, rng.uniform(0.2, 1, count), rng.uniform(0.3, 2, (count, 3)))
    return _still(replace(splats, surface=surface), Light.preset("left"))


def _before_wall(count: int) -> _World:
    splats = cloud(count)
    means = splats.means.copy()
    means[np.abs(means[:, 2]) < 1e-2, 2] = 1e-2  # rounding would decide whether a mean in the wall is visible
    splats = replace(splats, means=means)
    return _World(Scene([Item(splats), Item(_wall())]), reference.rest(splats), splats, wall=True)


def _layered(count: int) -> _World:
    splats = cloud(count)
    means = splats.means.copy()
    means[:, 2] = np.round(4 * means[:, 2]) / 4  # a dozen depths
    return _still(replace(splats, means=means))


SCENES = (
    ContractScene("splats", 300, lambda count: _still(cloud(count))),
    ContractScene("8-bit picture", 300, lambda count: _still(cloud(count), output="uint8")),
    ContractScene("equal depths", 3000, _layered),
    ContractScene("spherical harmonics", 300, lambda count: _still(cloud(count, 3))),
    ContractScene("antialias", 300, lambda count: _still(replace(cloud(count), antialias=True))),
    ContractScene("posed avatar", 300, lambda count: _posed(chain(count, 12))),
    ContractScene("expression", 300, lambda count: _posed(expressive(chain(count, 12)), 0.8)),
    ContractScene("light", 300, _lit),
    ContractScene("mesh", 300, _before_wall),
)
"""Scenes, simplest first."""
