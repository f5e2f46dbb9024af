"""Normals, occlusion and the light of a photograph on meshes whose answers are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.attribute_transfer import transferred_surface
from glsplat.extras.authoring.light.captured_light import CapturedLight, cloth_normals, with_captured_light
from glsplat.extras.authoring.light.surfaces import ambient_occlusion, locate_splats, with_surface
from glsplat.extras.authoring.paint.lamp import Lamp, find_light
from glsplat.light.light import Light
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats
from tests.extras.authoring.sample.test_surface import ball, rigged
from tests.light.lit import random_surface
from tests.scenes import cloud


def on_the_vertices(mesh: RiggedMesh, count: int) -> Avatar:
    """A round splat on each of the first vertices."""
    means = mesh.vertices[:count]
    ones = np.ones(count)
    splats = Splats.create(means, np.tile([1.0, 0, 0, 0], (count, 1)), np.full((count, 3), 0.01), ones, rgb=means * 0)
    return Avatar(splats, mesh.skeleton, Skin.create(mesh.joints[:count], mesh.weights[:count], 2))


def test_a_ball_is_open_and_its_normals_point_out() -> None:
    mesh = rigged(ball(0.3))
    avatar = with_surface(on_the_vertices(mesh, 640), mesh)
    surface = avatar.splats.surface
    assert surface is not None and surface.shade is None
    away = avatar.splats.means - mesh.vertices.mean(axis=0)
    away = away / np.linalg.norm(away, axis=1, keepdims=True)
    assert (surface.units * away).sum(axis=1).min() > 0.98
    assert surface.ao.min() > 0.9


@pytest.mark.check
def test_inner_surface_is_dark_and_gives_no_splat_its_normal() -> None:
    mesh = rigged(ball(0.3), ball(0.27, name="inside"))
    outer = len(ball(0.3)[0])
    occlusion = ambient_occlusion(mesh, mesh.vertices, 24)
    assert occlusion[outer:].max() < 0.1 and occlusion[:outer].min() > 0.9
    near = rigged(ball(0.3), ball(0.296, name="inside"))  # as the inside of a cheek
    splats = on_the_vertices(near, outer).splats
    deep = replace(splats, means=(splats.means - (0, 1, 0)) * 0.992 + (0, 1, 0))
    assert locate_splats(near, deep, occlusion).at(occlusion).min() > 0.8
    assert locate_splats(near, deep, np.ones(2 * outer)).at(occlusion).max() < 0.1  # as if it were open


def test_folded_cloth_gives_its_outer_side() -> None:
    near = rigged(ball(0.3), ball(0.299, name="folded"))  # a millimetre beneath, where some of the sky is seen
    outer = len(ball(0.3)[0])
    half_open = np.repeat([0.7, 0.25], outer)
    splats = on_the_vertices(near, 2 * outer).splats
    assert locate_splats(near, splats, half_open).at(half_open).min() > 0.65


def test_moved_splats_keep_their_surface_and_infinite_ones_are_tolerated() -> None:
    splats = cloud(50)
    moved = replace(splats, means=splats.means + 1e-4)
    surface = random_surface(50)
    found = transferred_surface(surface, splats, moved)
    assert found is not None and np.abs(found.units - surface.units).max() < 0.02
    assert np.array_equal(found.occlusion, surface.occlusion)
    means = np.array(splats.means)
    means[3] = np.nan
    hurt = transferred_surface(surface, replace(splats, means=means), moved)
    assert hurt is not None and len(hurt) == 50 and np.isfinite(hurt.units).all()
    assert transferred_surface(None, splats, moved) is None


def test_added_splats_hold_no_captured_light() -> None:
    mesh = rigged(ball(0.3))
    count = len(mesh.vertices)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    captured = CapturedLight(Light.uniform(), np.full(count, 0.5), np.ones(count), normals)
    surface = with_captured_light(on_the_vertices(mesh, 100), mesh, captured, 90).splats.surface
    assert surface.shades[:90] == pytest.approx(0.5, rel=0.02) and surface.shades[90:] == pytest.approx(1.0)


@pytest.mark.check
def test_only_splats_of_the_head_are_mixed_as_seen() -> None:
    vertices, part = ball(0.3)
    inner = ball(0.296, name="inside")
    for name, changes in (("head", True), ("spine1", False)):
        mesh = rigged((vertices, part), inner)
        mesh = replace(
            mesh, skeleton=Skeleton.from_joints((name, "jaw" if changes else "spine2"), [-1, 0], np.eye(2, 3))
        )
        count = len(mesh.vertices)
        normals = vertex_normals(mesh.vertices, mesh.faces)
        normals[len(vertices) :] *= -1  # a mouth's inside faces the other way
        captured = CapturedLight(Light.uniform(), np.full(count, 0.5), np.ones(count), normals)
        avatar = on_the_vertices(mesh, count)
        surface = with_captured_light(avatar, mesh, captured).splats.surface
        away = avatar.splats.means[len(vertices) :] - (0, 1, 0)
        out = (surface.units[len(vertices) :] * away).sum(axis=1) / np.linalg.norm(away, axis=1)
        assert (np.median(out) > 0) == changes, name


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


def test_normals_of_cloth_are_smoothed_and_of_a_face_kept() -> None:
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


DOUBTS = 1.5, 0.7


def seen_under(lamp: tuple[float, float, float], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals that a camera on -z sees, and colours of cloths under a lamp, with noise."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(4000, 3))
    normals[:, 2] = -np.abs(normals[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    albedo = rng.uniform(0.1, 0.8, (30, 3))[rng.integers(0, 30, 4000)] * rng.lognormal(0, 0.1, (4000, 3))
    way = np.array(lamp) / np.linalg.norm(lamp)
    light = Lamp(way, np.array([0.0, -1, 0]), 1.7)
    return normals, albedo * light.shade(normals)[:, None]


@pytest.mark.parametrize("lamp", [(-0.85, -0.55, -0.6), (0.85, -0.55, -0.6), (0.1, -0.9, -0.6)])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_lamp_at_the_side_is_found(lamp: tuple[float, float, float], seed: int) -> None:
    normals, colours = seen_under(lamp, seed)
    up, towards = np.array([0.0, -1, 0]), np.array([0.0, 0, -1])
    found = find_light(normals, colours, np.ones(4000), up, towards, DOUBTS)
    angle = np.degrees(np.arccos(found.direction @ np.array(lamp) / np.linalg.norm(lamp)))
    assert angle < 15 and 1.0 < found.strength < 2.6
    usual = find_light(normals, colours, np.ones(4000), up, towards)
    assert found.direction[0] * lamp[0] >= usual.direction[0] * lamp[0] - 0.02  # more doubt leans no less
