"""Normals of dressed bodies, on balls with dents: evened out where there is cloth, kept where there is a face."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.authoring.light.cloth import cloth_normals
from glsplat.meshes import MeshPart, RiggedMesh, vertex_normals
from glsplat.skinning.skeleton import Skeleton
from tests.authoring.test_surface import ball


def dented(upper: str, metres: float) -> tuple[RiggedMesh, np.ndarray]:
    """A ball of two joints with dents of that depth, and the unit normals of the one without."""
    vertices, part = ball(0.3)
    out = (vertices - (0, 1, 0)) / 0.3
    vertices = vertices + out * np.random.default_rng(5).normal(0, metres, (len(vertices), 1))
    held = np.zeros((len(vertices), 1), np.int64)
    held[out[:, 1] > 0] = 1
    skeleton = Skeleton.from_joints(("base", upper), [-1, 0], np.array([[0, 0.7, 0], [0, 1, 0]]))
    return RiggedMesh(vertices, skeleton, held, np.ones((len(vertices), 1)), (part,)), out


def off(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Degrees between unit vectors."""
    return np.asarray(np.degrees(np.arccos(np.einsum("nc,nc->n", one, other).clip(-1, 1))))


def test_cloth_is_evened_out_and_a_face_is_kept() -> None:
    mesh, round_ = dented("head", 0.006)
    own = vertex_normals(mesh.vertices, mesh.faces)
    (evened,) = cloth_normals(mesh, [mesh.vertices])
    below, above = round_[:, 1] < -0.25, round_[:, 1] > 0.25
    assert off(evened, round_)[below].mean() < 0.6 * off(own, round_)[below].mean()
    assert off(evened, own)[above].max() < 3
    assert np.linalg.norm(evened, axis=1) == pytest.approx(1)
    arm, _ = dented("left_shoulder", 0.006)
    (all_,) = cloth_normals(arm, [arm.vertices])
    assert off(all_, round_)[above].mean() < 0.6 * off(own, round_)[above].mean()


def test_a_round_body_stays_round_in_every_pose() -> None:
    mesh, round_ = dented("spine1", 0.0)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    still, turned = cloth_normals(mesh, [mesh.vertices, mesh.vertices @ turn.T])
    assert off(still, round_).max() < 2
    assert off(turned, still @ turn.T).max() < 0.1


def test_triangles_without_area_do_no_harm() -> None:
    mesh, round_ = dented("spine1", 0.0)
    part = mesh.parts[0]
    flat = np.array([[0, 0, 1], [2, 2, 2]], np.int32)
    more = MeshPart("flat", flat, np.zeros((2, 3, 2)), part.texture)
    vertices = np.concatenate([mesh.vertices, [[0.0, 5, 0]]])  # and a vertex of no triangle
    broken = replace(
        mesh,
        vertices=vertices,
        joints=np.concatenate([mesh.joints, [[0]]]),
        weights=np.concatenate([mesh.weights, [[1.0]]]),
        parts=(part, more),
    )
    (found,) = cloth_normals(broken, [vertices])
    assert np.isfinite(found).all() and off(found[:-1], round_).max() < 2
