"""Splats strewn over a body, in the colours that give back the picture."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.extras.authoring.body.open_face import with_expressions
from glsplat.extras.authoring.geometry.posed import placed
from glsplat.extras.authoring.optimize.colour_fit import _equations, fit_colours
from glsplat.extras.authoring.optimize.rasterizer import Rasterizer
from glsplat.extras.authoring.paint.painter import painter_of
from glsplat.extras.authoring.sample.scatter import scatter
from glsplat.meshes import vertex_normals
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.splats import SH_C0
from tests.extras.authoring.faces.figures import person
from tests.extras.authoring.paint.scene import photographed


def test_each_lip_s_splats_go_with_their_own_lip() -> None:
    mesh = person()
    face = with_expressions(mesh)
    opens = face.morphs.moved(Pose(np.zeros((55, 3)), expression={"jawOpen": 1.0}), len(mesh.vertices))
    down = np.linalg.norm(opens, axis=1)
    rng = np.random.default_rng(4)
    strewn = scatter(face, 6000, rng)
    moves = strewn.points.at(down[:, None])[:, 0]
    rgb = np.tile([0.5, 0.5, 0.5], (len(moves), 1))
    rgb[moves < 0.002] = (0, 0, 1)
    rgb[moves > 0.012] = (1, 0, 0)
    avatar = strewn.avatar(face, rgb, np.zeros(len(rgb)), np.random.default_rng(5))
    assert avatar.shapes is not None and len(avatar.shapes.names) == 52
    colour = avatar.splats.sh[:, 0] * SH_C0 + 0.5
    shapes, moved = avatar.shapes, np.zeros(len(avatar.splats))
    mine = shapes.targets == shapes.names.index("jawOpen")
    moved[shapes.rows[mine]] = np.linalg.norm(shapes.metres[mine], axis=1)
    upper, lower = colour[:, 2] - colour[:, 0] > 0.9, colour[:, 0] - colour[:, 2] > 0.9
    assert lower.sum() > 60 and upper.sum() > 3000
    assert moved[upper].max() < 0.006 and moved[lower].min() > 0.009


def test_a_front_does_not_show_through_an_unseen_back() -> None:
    mesh = person()
    strewn = scatter(mesh, 10_000, np.random.default_rng(4))
    front = strewn.points.directions(vertex_normals(mesh.vertices, mesh.faces))[:, 2] > 0
    white = np.repeat(front[:, None].astype(float), 3, axis=1)  # on a black back
    middle = np.append(mesh.skeleton.joints[JOINT_NAMES.index("spine3"), :2], 0)
    camera = Camera(look_at(middle - [0, 0, 4], middle), pinhole(80, 80, 2.5), 80, 80)

    def seen(contrast: np.ndarray | None) -> float:
        avatar = strewn.avatar(mesh, white, 0 * front, np.random.default_rng(2), contrast)
        return float(Rasterizer(len(avatar.splats)).draw(placed(avatar.splats), camera, True)[..., :3].mean())

    assert seen(1.0 - front) < 0.5 * seen(None)


def test_any_number_of_cores_gives_the_same_splats(monkeypatch: pytest.MonkeyPatch) -> None:
    strewn, found = scatter(person(), 900, np.random.default_rng(3)), set()
    rgb = np.random.default_rng(6).random((len(strewn.faces), 3))
    for count in (1, 3):
        monkeypatch.setattr("glsplat.extras.authoring.compute.threads.cores", lambda count=count: count)
        avatar = strewn.avatar(person(), rgb, rgb[:, 0], np.random.default_rng(2))
        made = avatar.splats
        arrays = made.means, made.quats, made.scales, made.sh, avatar.skin.joints, avatar.skin.weights
        found.add(b"".join(one.tobytes() for one in arrays))
    assert len(found) == 1
    assert np.allclose(avatar.skin.weights.sum(axis=1), 1, atol=1e-5)


@pytest.mark.check
def test_the_picture_comes_back() -> None:
    scene = photographed("front")
    rng = np.random.default_rng(0)
    strewn = scatter(scene.mesh, 3000, rng)
    painted = painter_of(scene.body, scene.shots, strewn.points).paint(strewn.points)
    avatar = strewn.avatar(scene.mesh, painted.rgb, painted.detail, rng)
    assert 0.99 * 3000 < len(avatar.splats) <= 3000
    assert np.isfinite(avatar.splats.means).all() and np.isfinite(avatar.splats.scales).all()
    matrix, target = _equations(avatar, scene.shots[0])

    def miss(colours: np.ndarray) -> float:
        return float(np.sqrt(((matrix @ (colours[:, 0] * SH_C0 + 0.5) - target) ** 2).mean()))

    sharp = fit_colours(avatar, scene.shots, 8)
    assert miss(sharp.splats.sh) < 0.6 * miss(avatar.splats.sh)
    hidden = np.asarray(matrix.sum(axis=0)).ravel() < 0.1  # pixels
    change = np.abs(sharp.splats.sh - avatar.splats.sh)[:, 0].max(axis=1) * SH_C0
    assert hidden.mean() > 0.1
    assert change[hidden].max() < 0.1 and change[~hidden].max() > 0.15
    np.testing.assert_array_equal(sharp.splats.means, avatar.splats.means)


def test_a_body_without_expressions_has_no_shapes() -> None:
    strewn = scatter(person(), 500, np.random.default_rng(1))
    grey = np.full((len(strewn.faces), 3), 0.5)
    assert strewn.avatar(person(), grey, np.zeros(len(grey)), np.random.default_rng(2)).shapes is None
