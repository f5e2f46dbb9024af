"""Shapes of splats from a mesh with expressions, and their transfer to other splats."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.finish.cones import ConeConfig, with_cones
from glsplat.extras.authoring.geometry.attribute_transfer import transferred_shapes
from glsplat.extras.authoring.geometry.mesh_shapes import body_morphs, with_shapes
from glsplat.extras.authoring.light.surfaces import with_surface
from glsplat.extras.authoring.optimize.refine import RefineConfig, refine
from glsplat.extras.authoring.sample.surface import SamplerConfig, make_avatar
from glsplat.extras.formats.person import read_body
from glsplat.meshes import MeshPart, Morphs, RiggedMesh
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Level, Splats
from tests.extras.authoring.sample.test_surface import ball, rigged

SIDE = 21


def sheet(morphs: dict[str, np.ndarray] | None = None) -> RiggedMesh:
    """A square of one metre in z = 0 of many triangles, on one joint; ``morphs``: name -> [V, 3]."""
    y, x = np.mgrid[0:SIDE, 0:SIDE] / (SIDE - 1.0) - 0.5
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    at = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    grey = np.full((4, 4, 4), 200, np.uint8)
    grey[..., 3] = 255
    part = MeshPart("sheet", faces, np.zeros((len(faces), 3, 2)), grey)
    skeleton = Skeleton.from_joints(["root"], [-1], [[0, 0, 0]])
    made = None
    if morphs is not None:
        rows = np.arange(len(vertices))
        made = Morphs.of({name: [(rows[o.any(axis=1)], o[o.any(axis=1)])] for name, o in morphs.items()})
    count = len(vertices)
    return RiggedMesh(vertices, skeleton, np.zeros((count, 1), int), np.ones((count, 1)), (part,), morphs=made)


def discs(count: int = 400, seed: int = 1) -> Avatar:
    """Discs in that square, turned about its normal, and some before it."""
    rng = np.random.default_rng(seed)
    means = np.concatenate([rng.uniform(-0.45, 0.45, (count, 2)), rng.uniform(0, 0.004, (count, 1))], axis=1)
    turn = rng.uniform(0, np.pi, count)
    quats = np.stack([np.cos(turn), 0 * turn, 0 * turn, np.sin(turn)], axis=1)
    scales = np.stack([rng.uniform(0.01, 0.02, count), rng.uniform(0.005, 0.01, count), np.full(count, 5e-4)], axis=1)
    splats = Splats.create(means, quats, scales, np.full(count, 0.9), rgb=rng.random((count, 3)))
    mesh = sheet()
    return Avatar(splats, mesh.skeleton, Skin(np.zeros((count, 1), int), np.ones((count, 1))))


def test_splats_move_and_bend_with_the_mesh() -> None:
    """A linear map of the plane, which triangles follow exactly."""
    linear = np.array([[1.3, 0.4, 0], [-0.1, 0.8, 0], [0.2, -0.3, 1]])
    mesh = sheet()
    face = sheet({"jawOpen": mesh.vertices @ (linear - np.eye(3)).T})
    avatar = with_shapes(discs(), face)
    assert avatar.shapes is not None and avatar.shapes.names == ("jawOpen",)
    found = reference.expressed(avatar.splats, avatar.shapes, np.ones(1))
    normal = np.cross(linear[:, 0], linear[:, 1])
    normal /= np.linalg.norm(normal)
    flat = avatar.splats.means * (1, 1, 0)
    wanted = flat @ linear.T + avatar.splats.means[:, 2:] * normal
    assert np.abs(found.means - wanted).max() < 2e-5  # 16 bits of the largest move
    in_plane = np.column_stack([linear[:, :2], normal])
    sigma = (in_plane @ reference.rest(avatar.splats).shapes)[:, :, :2]
    got = found.shapes[:, :, :2]
    assert np.abs(got @ got.transpose(0, 2, 1) - sigma @ sigma.transpose(0, 2, 1)).max() < 0.06 * 0.02**2


def test_small_moves_and_distant_splats_are_dropped() -> None:
    mesh = sheet()
    little = np.zeros_like(mesh.vertices)
    little[:, 2] = 5e-5
    half = np.where(mesh.vertices[:, :1] > 0.1, 1.0, 0.0) * (0, 0, 0.02)
    avatar = with_shapes(discs(), sheet({"cheekPuff": little, "jawOpen": half}))
    assert set(avatar.shapes.targets) == {1} and avatar.shapes.names == ("cheekPuff", "jawOpen")
    assert avatar.splats.means[avatar.shapes.rows, 0].min() > 0.04
    away = replace(discs(), splats=replace(discs().splats, means=discs().splats.means + np.float32((0, 0, 0.1))))
    assert len(with_shapes(away, sheet({"jawOpen": half})).shapes.targets) == 0  # type: ignore[union-attr]


def test_cones_of_a_still_face_are_dropped_and_levels_get_shapes() -> None:
    avatar = discs()
    cones = np.tile(np.int8([0, 0, 127, 0]), (len(avatar.splats), 1))
    avatar = replace(avatar, splats=replace(avatar.splats, cones=cones), levels=(Level(discs(60), 100.0),))
    made = with_shapes(avatar, sheet({"jawOpen": np.tile((0.0, 0.0, 0.02), (SIDE * SIDE, 1))}))
    assert made.splats.cones is None and len(made.levels) == 1
    assert made.levels[0].content.shapes is not None and len(made.levels[0].content.shapes.targets) == 60


def test_shapes_transfer_to_turned_and_moved_splats() -> None:
    linear = np.array([[1.2, 0.3, 0], [0.0, 0.9, 0], [0.3, -0.2, 1]])
    mesh = sheet()
    face = sheet({"jawOpen": mesh.vertices @ (linear - np.eye(3)).T})
    before, after = with_shapes(discs(), face), discs()
    turned = discs(seed=5).splats.quats
    moved = before.splats.means + np.float32((0.01, -0.02, 0))
    splats = replace(after.splats, quats=turned, means=moved)
    wanted = with_shapes(replace(after, splats=splats), face).shapes
    assert before.shapes is not None and wanted is not None
    found = transferred_shapes(before.shapes, before.splats, splats)
    one, other = (reference.expressed(splats, shapes, np.ones(1)) for shapes in (found, wanted))
    assert np.abs(one.means - other.means).max() < 2e-3  # the gradient is rounded to 0.024
    assert np.abs(one.shapes - other.shapes).max() < 0.06 * 0.02


def body_file(path: Path, **changes: Any) -> Path:
    mesh = sheet()
    data: dict[str, Any] = {
        "v_template": mesh.vertices, "faces": mesh.faces, "joint_names": np.array(["root"]), "parents": np.array([-1]),
        "joints": np.zeros((1, 3)), "skin_indices": np.zeros((SIDE**2, 1), int), "skin_weights": np.ones((SIDE**2, 1)),
        "expr_names": np.array(["jawOpen", "cheekPuff"]), "expr_ptr": np.array([0, 2, 3]),
        "expr_idx": np.array([5, 6, 7]), "expr_val": np.full((3, 3), 0.01, np.float16),
    }  # fmt: skip
    np.savez(path, **(data | changes))
    return path


def test_a_body_file_has_expressions(tmp_path: Path) -> None:
    morphs = read_body(body_file(tmp_path / "body.npz")).morphs
    assert morphs is not None and morphs.names == ("jawOpen", "cheekPuff") and morphs.vertices.tolist() == [5, 6, 7]


@pytest.mark.parametrize(
    "changes",
    [
        {"expr_ptr": np.array([0, 2])},
        {"expr_ptr": np.array([0, 10**9, 3])},
        {"expr_ptr": np.array([0, 3, 2])},
        {"expr_idx": np.array([5, 6, 10**6])},
        {"expr_idx": np.array([5, 6, -1])},
        {"expr_val": np.full((3, 3), np.nan)},
        {"expr_val": np.zeros((2, 3))},
        {"expr_names": np.array(["a", "a"])},
    ],
)
def test_invalid_expressions_of_a_body_are_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    path = body_file(tmp_path / "body.npz", **changes)
    with pytest.raises(FormatError) as caught:
        read_body(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_points_near_a_body_move_as_its_surface() -> None:
    rows = np.arange(SIDE * SIDE)
    mesh = sheet()
    body = replace(mesh, morphs=Morphs.of({"jawOpen": [(rows, mesh.vertices * (0.1, 0, 0))]}))
    points = np.array([[0.23, 0.11, 0.01], [-0.4, 0.2, 0.0], [0.0, 0.0, 5.0]])
    found = body_morphs(body, points)
    assert found is not None and found.vertices.tolist() == [0, 1]
    assert found.offsets == pytest.approx(np.array([[0.023, 0, 0], [-0.04, 0, 0]]), abs=1e-6)
    assert body_morphs(body, mesh.vertices + 0.001) is body.morphs


def test_cones_hide_nothing_that_a_face_moves_or_uncovers() -> None:
    """Two opaque walls of discs, of which each hides the other, and half of the nearer one moves."""
    thin = discs(400).splats
    scales, means = np.tile(np.float32((0.06, 0.05, 0.001)), (400, 1)), thin.means.copy()
    means[::2, 2] -= 0.2
    avatar = replace(discs(400), splats=replace(thin, scales=scales, means=means, opacities=np.full(400, 0.97)))
    half = np.where(sheet().vertices[:, :1] > 0.2, 1.0, 0.0) * (0, 0, 0.02)
    face = with_shapes(avatar, sheet({"jawOpen": half}))
    few = ConeConfig(directions=16, poses=2, size=64, choosing=2, tests=2, rounds=1, test_size=64, psnr=25.0)
    cones, still = (with_cones(one, few).splats.cones for one in (face, avatar))
    near = (means[:, 0] > 0.2) & (means[:, 2] > -0.1)
    assert (cones[near, 3] == -127).all() and (still[near, 3] > -127).mean() > 0.3
    assert np.array_equal(cones[means[:, 0] < 0.0], still[means[:, 0] < 0.0])
    assert (cones[np.diff(face.shapes.starts) > 0, 3] == -127).all()


@pytest.mark.check
def test_the_fit_without_numba_transfers_shapes_and_surface() -> None:
    mesh = rigged(ball(0.3))
    moves = np.zeros_like(mesh.vertices)
    moves[:, 2] = 0.4 * (mesh.vertices[:, 1] - mesh.vertices[:, 1].mean())
    face = replace(mesh, morphs=Morphs.of({"jawOpen": [(np.arange(len(moves)), moves)]}))
    start = with_surface(make_avatar(face, 200, 1, SamplerConfig(probe=128)), face)
    assert start.shapes is not None
    made = refine(start, face, 5, RefineConfig(steps=4, size=48))
    assert made.shapes is not None and made.splats.surface is not None
    assert np.abs(made.splats.means - start.splats.means).max() > 1e-4
    found = reference.expressed(made.splats, made.shapes, np.ones(1))
    linear = np.eye(3)
    linear[2, 1] = 0.4
    rest = reference.expressed(made.splats, made.shapes, np.zeros(1))
    wanted = rest.shapes @ np.swapaxes(rest.shapes, 1, 2)
    error = np.abs(found.shapes @ np.swapaxes(found.shapes, 1, 2) - linear @ wanted @ linear.T).max(axis=(1, 2))
    assert np.median(error / np.abs(wanted).max(axis=(1, 2))) < 0.2


def test_without_expressions_nothing_changes() -> None:
    avatar = discs()
    assert with_shapes(avatar, sheet()) is avatar
