"""A made-up person whose colours and light are known, photographed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from glsplat.camera import Camera
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.extras.authoring.dress.fitted_mesh import dressed_mesh
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.extras.authoring.fit.kinematics import projected
from glsplat.extras.authoring.fit.prior import HINGES
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.pictures import to_srgb
from tests.extras.authoring.made_up import FOCAL, posed_view

__all__ = ["Scene", "albedo", "photographed"]

_TIMES = 2  # as many pixels a side as the made-up views have


@dataclass(frozen=True, eq=False)
class Scene:
    """The person, and the pictures of them."""

    body: Body
    fit: BodyFit
    mesh: RiggedMesh
    light: Lamp  # axes of the first picture's camera
    shots: list[FittedPicture]


def albedo(mesh: RiggedMesh) -> np.ndarray:
    """[V, 3] linear: trousers, a shirt and skin by height, the same in front and behind."""
    height = mesh.vertices[:, 1] / mesh.vertices[:, 1].max()
    colours = np.array([[0.05, 0.08, 0.25], [0.5, 0.1, 0.08], [0.45, 0.3, 0.22]])
    return np.asarray(colours[np.digitize(height, [0.52, 0.84])])


@cache
def photographed(*sides: str, lamp: tuple[float, float, float] = (0.5, -0.6, -0.62), strength: float = 1.4) -> Scene:
    """The person from each side; the light stays with the person. ``lamp``: camera axes of the first side."""
    body = open_body()
    views, fitted = [], []
    for side in sides:
        view, posed, solver = posed_view(side)
        where = posed.points(body.points(np.arange(len(body.vertices))))
        pixels = projected(where, FOCAL * _TIMES, view.centre * _TIMES)[0]
        angles = HINGES.rotations(solver.angles(0))
        fitted.append(FittedView(angles, posed.frames[0], posed.joints[0], posed.joints, where, pixels, 1.0, 0.0))
        views.append(view)
    rest, joints = body.shaped(solver.betas)
    fit = BodyFit(solver.betas, 1.7, np.zeros(len(rest)), rest, joints, tuple(fitted), "")
    mesh = dressed_mesh(body, fit)
    light = Lamp(np.array(lamp) / np.linalg.norm(lamp), fitted[0].root[:, 1], strength)
    shots = []
    for view, seen in zip(views, fitted, strict=True):
        height, width = (side * _TIMES for side in view.mask.shape)
        middle = view.centre * _TIMES
        k = np.array([[FOCAL * _TIMES, 0, middle[0]], [0, FOCAL * _TIMES, middle[1]], [0, 0, 1]])
        ids, bary = visible_faces(mesh, seen.vertices, Camera(np.eye(4), k, width, height))
        hit = ids >= 0
        normals = vertex_normals(seen.vertices, mesh.faces) @ (seen.root @ fitted[0].root.T)
        lit = albedo(mesh) * light.shade(normals)[:, None] * 0.6
        picture = np.full((height, width, 3), 0.3)
        picture[hit] = to_srgb(np.einsum("nk,nkc->nc", bary[hit], lit[mesh.faces[ids[hit]]]))
        shots.append(FittedPicture(np.rint(picture * 255).astype(np.uint8), hit, FOCAL * _TIMES, seen, mesh))
    return Scene(body, fit, mesh, light, shots)
