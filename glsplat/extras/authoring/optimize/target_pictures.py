"""Target pictures for fits of splats: from around, near head, hands and feet, and in other poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.errors import ContextError, GlsplatError
from glsplat.extras.authoring.geometry.posed import drawable, placed, posed_splats
from glsplat.extras.authoring.geometry.raster import mesh_picture
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.authoring.optimize.cameras import Subject, TargetView, ViewConfig, views_of
from glsplat.extras.authoring.optimize.rasterizer import Rasterizer
from glsplat.gl.context import Context, create_context
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import strongest_joint
from glsplat.splats import Splats

__all__ = ["TargetPicture", "ViewConfig", "pictures_of", "pictures_of_splats"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
Report = Callable[[str, float], None]

_RIM_PX = 8  # around the subject, where splats must not be
_REGIONS = {"lids": ("eyeBlinkLeft", "eyeBlinkRight"), "lips": ("mouthFunnel", "mouthPucker")}
_MIN_MOVE_M = 0.001  # by an expression, of the vertices of its region


@dataclass(frozen=True, eq=False, slots=True)
class TargetPicture:
    """A picture that splats are fitted to."""

    camera: Camera
    target: U8  # [H, W, 4] premultiplied, over nothing
    metres_per_pixel: float  # weight of its errors, so that close-ups do not dominate
    pose: Pose | None = None  # None: the zero pose
    trust: F32 | None = None  # [H, W] weight of errors; None: 1


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
    subject = Subject(
        mesh.skeleton.names, mesh.vertices[used], strongest[used], lambda pose: mesh.posed(pose)[used], regions
    )
    views = list(views_of(subject, np.random.default_rng((seed, 17)), config or ViewConfig()))
    return _cropped_pictures(views, _mesh_pictures(mesh, views, context), progress)


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

    subject = Subject(
        avatar.skeleton.names, zero.means.astype(np.float64), strongest[usable], lambda pose: shown(pose).means
    )
    views = list(views_of(subject, np.random.default_rng((seed, 17)), config or ViewConfig()))
    drawing = Rasterizer(len(zero))
    drawn = (_eight_bit(drawing.draw(placed(shown(view.pose)), view.camera, zero.antialias)) for view in views)
    return _cropped_pictures(views, drawn, progress)


def _moved_vertices(mesh: RiggedMesh, names: tuple[str, ...]) -> NDArray[np.bool_]:
    """Return True [V] for vertices that one of these expressions moves."""
    assert mesh.morphs is not None
    found = np.zeros(len(mesh.vertices), bool)
    for name in names:
        pose = Pose(np.zeros((len(mesh.skeleton), 3)), expression={name: 1.0})
        found |= np.linalg.norm(mesh.morphs.moved(pose, len(found)), axis=1) > _MIN_MOVE_M
    return found


def _cropped_pictures(views: list[TargetView], drawn: Iterator[U8], progress: Report | None) -> list[TargetPicture]:
    out = []
    for index, (view, picture) in enumerate(zip(views, drawn, strict=True)):
        if progress:
            progress("drawing target pictures", index / len(views))
        out.append(_cropped(view, picture))
    return out


def _mesh_pictures(mesh: RiggedMesh, views: list[TargetView], context: Context | None) -> Iterator[U8]:
    own = None
    if context is None:
        try:
            context = own = create_context()
        except ContextError:
            for view in views:
                pose = view.pose or Pose.zero(len(mesh.skeleton))
                yield _eight_bit(mesh_picture(mesh, mesh.posed(pose), view.camera, 2))
            return
    renderers: dict[tuple[int, int], MeshTruth] = {}
    try:
        for view in views:
            size, face = view.camera.width, id(view.pose) if view.pose and view.pose.expression else 0
            if (size, face) not in renderers:
                shown = mesh if view.pose is None or not face else _expressed(mesh, view.pose)
                renderers[size, face] = MeshTruth(  # points of the texture, as raster.py takes them
                    shown, size=(size, size), samples=1, supersample=3, anisotropy=1, context=context
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
