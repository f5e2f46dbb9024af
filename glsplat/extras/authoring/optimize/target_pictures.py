"""Target pictures for fits of splats: from around, near head, hands and feet, and in other poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import ContextError, GlsplatError
from glsplat.extras.authoring.geometry.posed import PosedSplats, drawable, placed, posed_splats
from glsplat.extras.authoring.geometry.raster import mesh_picture
from glsplat.extras.authoring.geometry.visibility import EYES, GAZE_LIDS, HEAD
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.authoring.optimize.rasterizer import Rasterizer
from glsplat.extras.authoring.optimize.refine import random_pose
from glsplat.gl.context import Context, create_context
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import strongest_joint
from glsplat.splats import Splats

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
Report = Callable[[str, float], None]

_RIM_PX = 8  # around the subject, where splats must not be
_HEAD_ANGLES_DEG = (  # around and up
    *((-90, 0), (-50, 10), (-20, -8), (0, 5), (20, 15), (50, -5), (90, 5)),
    *((180, 10), (135, 25), (-135, 0), (0, 25), (0, -20)),
)
_HAND_ANGLES_DEG = ((0, 0), (180, 10), (20, 60), (0, -60))
_FOOT_ANGLES_DEG = ((0, 20), (180, 15), (90, 10), (-90, 10))
_HAND, _FOOT = ("wrist", "index", "middle", "pinky", "ring", "thumb"), ("ankle", "foot")
_CLOSE_UPS = (  # prefixes of the names of joints, and the angles
    (HEAD, _HEAD_ANGLES_DEG),
    *((tuple(f"{side}_{part}" for part in _HAND), _HAND_ANGLES_DEG) for side in ("left", "right")),
    *((tuple(f"{side}_{part}" for part in _FOOT), _FOOT_ANGLES_DEG) for side in ("left", "right")),
)
_EXPRESSIONS: tuple[dict[str, float], ...] = (  # others are close to one of these
    {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
    {"eyeBlinkLeft": 0.5, "eyeBlinkRight": 0.5, "browDownLeft": 0.7, "browDownRight": 0.7},
    {"jawOpen": 0.7},
    {"jawOpen": 0.35, "mouthFunnel": 0.6},
    {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0, "cheekSquintLeft": 0.6, "cheekSquintRight": 0.6},
    dict.fromkeys(("mouthUpperUpLeft", "mouthUpperUpRight", "mouthLowerDownLeft", "mouthLowerDownRight"), 0.7),
    {"mouthPucker": 1.0, "browInnerUp": 0.8},
    {"jawOpen": 0.5, "tongueOut": 1.0, "eyeWideLeft": 0.8, "eyeWideRight": 0.8},
)
_REVEALING = _EXPRESSIONS[0], _EXPRESSIONS[2]  # lids, teeth and tongue
_FACE_ANGLES_DEG = ((0, 0), (-35, 5), (35, -5))
_REGIONS = {"lids": ("eyeBlinkLeft", "eyeBlinkRight"), "lips": ("mouthFunnel", "mouthPucker")}
_MIN_MOVE_M = 0.001  # by an expression, of the vertices of its region
_MIN_HALF_TAN = 1e-3  # tangent of half an angle of view, for a hand of a single splat


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewConfig:
    """Number and size of the pictures."""

    body: int = 24  # pictures from around, in the zero pose
    poses: int = 12  # random poses
    each: int = 2  # pictures of each random pose
    size: int = 768  # pixels a side of a whole body
    close: int = 384  # pixels a side of a head, a hand or a foot, and of a face with an expression
    supersample: int = 3  # points across a pixel, of pictures of a mesh
    elevations: tuple[float, ...] = (-12, 8, 30)  # degrees of cameras around the zero pose, in turn
    elevation_spread: float = 15.0  # degrees, standard deviation for other poses


_CONSISTENCY_VIEWS = ViewConfig(body=12, poses=0, size=256, close=192)


@dataclass(frozen=True, eq=False, slots=True)
class TargetPicture:
    """A picture that splats are fitted to."""

    camera: Camera
    target: U8  # [H, W, 4] premultiplied, over nothing
    metres_per_pixel: float  # weight of its errors, so that close-ups do not dominate
    pose: Pose | None = None  # None: the zero pose
    trust: F32 | None = None  # [H, W] weight of errors; None: 1


class TargetView(NamedTuple):
    """A camera and the points it frames."""

    camera: Camera
    points: F64
    pose: Pose | None


def pictures_of(
    mesh: RiggedMesh,
    seed: int = 0,
    config: ViewConfig | None = None,
    progress: Report | None = None,
    context: Context | None = None,
) -> list[TargetPicture]:
    """Return pictures of the unlit mesh, drawn by OpenGL or, without a context, in numpy. Deterministic."""
    used = np.unique(mesh.faces)
    strongest = strongest_joint(mesh.joints, mesh.weights)
    regions = {name: _moved_vertices(mesh, names)[used] for name, names in _REGIONS.items() if mesh.morphs is not None}
    subject = _Subject(
        mesh.skeleton.names, mesh.vertices[used], strongest[used], lambda pose: mesh.posed(pose)[used], regions
    )
    config = config or ViewConfig()
    views = list(_views(subject, np.random.default_rng((seed, 17)), config))
    return _cropped_pictures(views, _mesh_pictures(mesh, views, config.supersample, context), progress)


def pictures_of_splats(
    avatar: Avatar, seed: int = 0, config: ViewConfig | None = None, progress: Report | None = None
) -> list[TargetPicture]:
    """Return pictures of an avatar's own splats in their colours of degree 0, drawn on the CPU. Deterministic.

    Raises GlsplatError where no splat can be drawn.
    """
    usable = drawable(avatar.splats)
    if not usable.any():
        raise GlsplatError("pictures of an avatar need at least one finite splat")
    skin = avatar.skin
    strongest = strongest_joint(skin.joints, skin.weights)
    zero = avatar.splats.take(usable)

    def shown(pose: Pose | None) -> Splats:
        return zero if pose is None else posed_splats(avatar, pose).take(usable)

    subject = _Subject(
        avatar.skeleton.names, zero.means.astype(np.float64), strongest[usable], lambda pose: shown(pose).means
    )
    views = list(_views(subject, np.random.default_rng((seed, 17)), config or ViewConfig()))
    drawing = Rasterizer(len(zero))
    drawn = (_eight_bit(drawing.draw(placed(shown(view.pose)), view.camera, zero.antialias)) for view in views)
    return _cropped_pictures(views, drawn, progress)


def consistency_views(avatar: Avatar) -> Iterator[tuple[PosedSplats, list[Camera]]]:
    """Yield splats and cameras: the zero pose from around, head, hands and feet; then the face in two expressions."""
    skin, usable = avatar.skin, drawable(avatar.splats)
    if not usable.any():
        return
    strongest = strongest_joint(skin.joints, skin.weights)[usable]
    names, means = avatar.skeleton.names, avatar.splats.means[usable].astype(np.float64)
    views = _views(_Subject(names, means, strongest, lambda pose: means), np.random.default_rng(0), _CONSISTENCY_VIEWS)
    yield placed(avatar.splats), [view.camera for view in views]
    head = means[np.array([name.startswith(HEAD) for name in names])[strongest]]
    if avatar.shapes is None or not len(head):
        return
    cameras = [_camera(head, around, up, _CONSISTENCY_VIEWS.close, 1.5) for around, up in _FACE_ANGLES_DEG]
    for expression in _REVEALING:
        yield placed(posed_splats(avatar, Pose(np.zeros((len(names), 3)), expression=expression))), cameras


def _moved_vertices(mesh: RiggedMesh, names: tuple[str, ...]) -> NDArray[np.bool_]:
    """Return True [V] for vertices that one of these expressions moves."""
    assert mesh.morphs is not None
    found = np.zeros(len(mesh.vertices), bool)
    for name in names:
        pose = Pose(np.zeros((len(mesh.skeleton), 3)), expression={name: 1.0})
        found |= np.linalg.norm(mesh.morphs.moved(pose, len(found)), axis=1) > _MIN_MOVE_M
    return found


class _Subject(NamedTuple):
    """The subject of the pictures: P points of a mesh or of splats."""

    names: tuple[str, ...]  # of the joints
    points: F64  # [P, 3] in the zero pose
    strongest: NDArray[np.integer]  # [P] the joint that moves a point most
    posed: Callable[[Pose], NDArray[np.floating]]  # [P, 3]
    regions: Mapping[str, NDArray[np.bool_]] = MappingProxyType({})  # [P] of a face with expressions


def _cropped_pictures(views: list[TargetView], drawn: Iterator[U8], progress: Report | None) -> list[TargetPicture]:
    out = []
    for index, (view, picture) in enumerate(zip(views, drawn, strict=True)):
        if progress:
            progress("drawing target pictures", index / len(views))
        out.append(_cropped(view, picture))
    return out


def _mesh_pictures(
    mesh: RiggedMesh, views: list[TargetView], supersample: int, context: Context | None
) -> Iterator[U8]:
    own = None
    if context is None:
        try:
            context = own = create_context()
        except ContextError:
            for view in views:
                pose = view.pose or Pose.zero(len(mesh.skeleton))
                yield _eight_bit(mesh_picture(mesh, mesh.posed(pose), view.camera, supersample))
            return
    renderers: dict[tuple[int, int], MeshTruth] = {}
    try:
        for view in views:
            size, face = view.camera.width, id(view.pose) if view.pose and view.pose.expression else 0
            if (size, face) not in renderers:
                shown = mesh if view.pose is None or not face else _expressed(mesh, view.pose)
                renderers[size, face] = MeshTruth(  # points of the texture, as raster.py takes them
                    shown, size=(size, size), samples=1, supersample=supersample, anisotropy=1, context=context
                )
            yield renderers[size, face].render([view.camera], view.pose)[0]
    finally:
        for renderer in renderers.values():
            renderer.release()
        if own is not None:
            own.release()


def _expressed(mesh: RiggedMesh, pose: Pose) -> RiggedMesh:
    """Return the mesh with the pose's expression in its vertices: its renderer has no expressions."""
    if mesh.morphs is None:
        return mesh
    return replace(mesh, vertices=mesh.vertices + mesh.morphs.moved(pose, len(mesh.vertices)), morphs=None)


def _eight_bit(picture: NDArray[np.floating]) -> U8:
    return np.asarray(np.clip(picture * 255 + 0.5, 0, 255), np.uint8)


def _views(subject: _Subject, rng: np.random.Generator, config: ViewConfig) -> Iterator[TargetView]:
    names, points, strongest, posed_points, regions = subject
    for k in range(config.body):
        up = config.elevations[k % len(config.elevations)]
        yield TargetView(_camera(points, 360 * k / config.body, up, config.size, 3.0), points, None)
    for wanted, sides in _CLOSE_UPS:
        some = points[np.array([name.startswith(wanted) for name in names])[strongest]]
        for around, up in sides if len(some) else ():
            yield TargetView(_camera(some, around, up, config.close, 1.5), some, None)
    if any(mine.any() for mine in regions.values()):
        yield from _faces(subject, config)
    for k in range(config.poses):
        pose = random_pose(names, rng)
        posed = np.asarray(posed_points(pose), np.float64)
        for j in range(config.each):
            turned = 360 * (k / config.poses + j / config.each) + rng.uniform(-15, 15)
            up = float(rng.normal(5, config.elevation_spread))
            yield TargetView(_camera(posed, turned, up, config.size, 3.0), posed, pose)


def _faces(subject: _Subject, config: ViewConfig) -> Iterator[TargetView]:
    """Yield views of each expression and gaze: the face from three sides, lids and lips closer."""
    joints = len(subject.names)
    still = np.zeros((joints, 3))
    poses = [Pose(still, expression=one) for one in _EXPRESSIONS]
    eyes = [subject.names.index(name) for name in EYES if name in subject.names]
    for turn, lids in GAZE_LIDS.items() if eyes else ():
        rotations = still.copy()
        rotations[eyes] = np.radians((*turn, 0))
        poses.append(Pose(rotations, expression=dict.fromkeys(lids, 1.0)))
    every = np.any(list(subject.regions.values()), axis=0)
    for index, pose in enumerate([None, *poses]):
        posed = subject.points if pose is None else np.asarray(subject.posed(pose), np.float64)
        for around, up in _FACE_ANGLES_DEG:
            yield TargetView(_camera(posed[every], around, up, config.close, 1.5), posed[every], pose)
        for number, mine in enumerate(subject.regions.values()):
            if mine.any():
                side = 0 if pose is None else (-25, 0, 25)[(index + number) % 3]
                yield TargetView(_camera(posed[mine], side, 0, config.close, 1.5), posed[mine], pose)


def _camera(points: F64, around: float, up: float, size: int, distance: float, fill: float = 0.94) -> Camera:
    """Return a camera ``around`` and ``up`` degrees from the front, whose picture the points ``fill``."""
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    turn, lift = np.radians((around, min(max(up, -80.0), 80.0)))
    towards = np.array([np.cos(lift) * np.sin(turn), np.sin(lift), np.cos(lift) * np.cos(turn)])
    away = max(distance, 1.5 * float(np.linalg.norm(points - middle, axis=1).max()))
    viewmat = look_at(middle + away * towards, middle)
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    half = max(float(np.abs(seen[:, :2] / seen[:, 2:]).max()), _MIN_HALF_TAN)
    return Camera(viewmat, pinhole(size, size, float(2 * np.degrees(np.arctan(half / fill)))), size, size)


def _cropped(view: TargetView, picture: U8) -> TargetPicture:
    """Return the part of the picture around the subject, with a rim."""
    camera = view.camera
    seen = view.points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    pixels = (seen @ camera.K.T)[:, :2] / seen[:, 2:]
    low = np.clip(np.floor(pixels.min(axis=0)) - _RIM_PX, 0, camera.width - 16).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + _RIM_PX, low + 16, camera.width).astype(int)
    K = camera.K.copy()
    K[:2, 2] -= low
    cut = Camera(camera.viewmat, K, int(high[0] - low[0]), int(high[1] - low[1]), near=camera.near)
    target = np.ascontiguousarray(picture[low[1] : high[1], low[0] : high[0]])
    return TargetPicture(cut, target, float(np.median(seen[:, 2])) / float(K[0, 0]), view.pose)
