"""Cloth bridges the cleft of the seat, and fronts keep their outlines."""

from __future__ import annotations

import numpy as np

from glsplat.extras.authoring.dress.fitted_mesh import dressed_mesh
from glsplat.extras.authoring.dress.skirt import dress
from glsplat.extras.authoring.fit.view import View
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.authoring.made_up import posed_view
from tests.extras.authoring.paint.scene import photographed

_HEIGHTS_M = 0.03, 0.05  # above the hip joints


def test_cloth_bridges_the_cleft_of_the_seat() -> None:
    scene = photographed("front")
    shot, (view, _, _) = scene.shots[0], posed_view("front")
    front = View(shot.mask, view.landmarks * 2, view.visibility, shot.focal, view.centre * 2)
    before = dressed_mesh(scene.body, scene.fit)
    mesh, (seen,) = dress(scene.body, scene.fit, [front], shot.rgb)
    seat = scene.body.skin & (mesh.vertices[:, 2] < mesh.skeleton.joints[0, 2])
    across = np.abs(mesh.vertices[:, 0])
    hip = mesh.skeleton.joints[JOINT_NAMES.index("left_hip"), 1]

    def cleft(vertices: np.ndarray, height: float) -> float:
        row = seat & (np.abs(vertices[:, 1] - hip - height) < 0.015)
        return float(np.median(vertices[row & (across < 0.006), 2]) - vertices[row & (across < 0.12), 2].min())

    for height in _HEIGHTS_M:
        was, now = cleft(before.vertices, height), cleft(mesh.vertices, height)
        assert was > 0.012 and now < was / 2, (height, was, now)
    moved = mesh.vertices - before.vertices
    back = np.abs(moved[:, 2]) > 1e-3
    assert back[seat].any() and moved[back & seat, 2].max() < 0
    assert np.abs(moved[seat & (across < 0.12)][:, :2]).max() < 1e-6
    at = shot.project(seen.vertices)
    assert np.abs(at - seen.pixels).max() < 1e-3
