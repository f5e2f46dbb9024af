"""Unseen hair: as long as in front, and behind the neck."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.extras.authoring.paint.inpaint.hair import with_hair
from glsplat.extras.authoring.paint.painter import painter_of
from glsplat.extras.authoring.sample.scatter import even_points
from glsplat.meshes import vertex_normals
from glsplat.pictures import to_linear
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.authoring.paint import scene as made_up
from tests.extras.authoring.paint.scene import Scene, albedo, photographed

HAIR = np.array([0.02, 0.06, 0.02])


def haired(monkeypatch: pytest.MonkeyPatch, lowest: float) -> Scene:
    """Somebody whose green hair hangs beside the face and before the shoulders down to ``lowest`` heights."""

    def with_hair_on(mesh: object) -> np.ndarray:
        colours = albedo(mesh)
        where = mesh.vertices / mesh.vertices[:, 1].max()
        x, y, z = where.T
        head = y > max(lowest, 0.86)
        face = (np.abs(x) < 0.03) & (y > 0.89) & (y < 0.96) & (z > 0.045)
        beside = (y > lowest) & (y <= 0.86) & (np.abs(x) > 0.02) & (np.abs(x) < 0.08)
        colours[head | beside] = HAIR
        colours[face] = (0.45, 0.3, 0.22)
        return colours

    monkeypatch.setattr(made_up, "albedo", with_hair_on)
    return photographed.__wrapped__("front")


def test_long_hair_hangs_behind_the_neck_and_short_hair_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = haired(monkeypatch, 0.76)
    (shot,) = with_hair(scene.body, scene.shots)
    before, after = scene.mesh.vertices, shot.mesh.vertices
    assert (after[:, 2] <= before[:, 2] + 1e-9).all() and (after[:, :2] == before[:, :2]).all()
    neck = np.isin(scene.body.part, [JOINT_NAMES.index("neck")]) & (before[:, 2] < np.median(before[:, 2]))
    moved = before[:, 2] - after[:, 2]
    assert moved[neck].max() > 0.02
    front = scene.shots[0].visibility > 0.5
    assert moved[front].max() < 0.003  # visible surface stays
    points = even_points(shot.mesh, 30_000)
    where = points.at(shot.mesh.vertices) / shot.mesh.vertices[:, 1].max()
    behind = points.directions(vertex_normals(shot.mesh.vertices, shot.mesh.faces))[:, 2] < -0.6
    behind &= (where[:, 2] < 0) & (where[:, 1] > 0.86) & (where[:, 1] < 0.95) & (np.abs(where[:, 0]) < 0.03)
    colours = to_linear(painter_of(scene.body, [shot], points).colours(points))[behind]
    assert len(colours) > 30 and (colours[:, 1] > 1.5 * colours[:, 0]).mean() > 0.9
    short = haired(monkeypatch, 0.9)
    assert with_hair(short.body, short.shots) == short.shots
