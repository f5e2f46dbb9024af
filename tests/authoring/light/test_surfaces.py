"""Normals and occlusion of meshes whose answers are known: balls, a plane under a roof, a ball in a ball."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.authoring.light.capture import CapturedLight, with_captured_light
from glsplat.authoring.light.carried import surface_carried
from glsplat.authoring.light.occlusion import ambient_occlusion
from glsplat.authoring.light.surfaces import nearest_open, with_surface
from glsplat.avatar import Avatar
from glsplat.light.light import Light
from glsplat.light.surface import Surface
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats
from tests.authoring.test_surface import ball, rigged
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
def test_what_lies_inside_is_dark_and_lends_nothing_its_normal() -> None:
    mesh = rigged(ball(0.3), ball(0.27, name="inside"))
    outer = len(ball(0.3)[0])
    occlusion = ambient_occlusion(mesh, mesh.vertices, 24)
    assert occlusion[outer:].max() < 0.1 and occlusion[:outer].min() > 0.9
    near = rigged(ball(0.3), ball(0.296, name="inside"))  # as the inside of a cheek
    splats = on_the_vertices(near, outer).splats
    deep = replace(splats, means=(splats.means - (0, 1, 0)) * 0.992 + (0, 1, 0))
    assert nearest_open(near, deep, occlusion).at(occlusion).min() > 0.8
    assert nearest_open(near, deep, np.ones(2 * outer)).at(occlusion).max() < 0.1  # as if it were open


def test_of_cloth_folded_over_itself_the_outer_side_is_taken() -> None:
    near = rigged(ball(0.3), ball(0.299, name="folded"))  # a millimetre beneath, where some of the sky is seen
    outer = len(ball(0.3)[0])
    half_open = np.repeat([0.7, 0.25], outer)
    splats = on_the_vertices(near, 2 * outer).splats
    assert nearest_open(near, splats, half_open).at(half_open).min() > 0.65


def test_two_balls_shade_each_other_where_they_touch() -> None:
    vertices, part = ball(0.3)
    mesh = rigged((vertices, part), (vertices + (0.61, 0, 0), replace(part, name="beside")))
    occlusion = ambient_occlusion(mesh, mesh.vertices, 24)
    first = occlusion[: len(vertices)]
    near, far = vertices[:, 0].argmax(), vertices[:, 0].argmin()
    assert first[near] < 0.35 and first[far] > 0.97


def test_moved_splats_keep_theirs_and_infinite_ones_do_no_harm() -> None:
    splats = cloud(50)
    moved = replace(splats, means=splats.means + 1e-4)
    surface = random_surface(50)
    found = surface_carried(surface, splats, moved)
    assert found is not None and np.abs(found.units - surface.units).max() < 0.02
    assert np.array_equal(found.occlusion, surface.occlusion)
    means = np.array(splats.means)
    means[3] = np.nan
    hurt = surface_carried(surface, replace(splats, means=means), moved)
    assert hurt is not None and len(hurt) == 50 and np.isfinite(hurt.units).all()
    assert surface_carried(None, splats, moved) is None


@pytest.mark.parametrize("normals", [np.zeros((5, 3)), np.full((5, 3), np.nan)])
def test_no_normal_stays_none(normals: np.ndarray) -> None:
    assert not Surface.of(normals, np.ones(5)).normals.any()


def test_colours_that_no_photograph_gave_hold_no_light() -> None:
    mesh = rigged(ball(0.3))
    count = len(mesh.vertices)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    captured = CapturedLight(Light.uniform(), np.full(count, 0.5), np.ones(count), normals)
    surface = with_captured_light(on_the_vertices(mesh, 100), mesh, captured, 90).splats.surface
    assert surface.shades[:90] == pytest.approx(0.5, rel=0.02) and surface.shades[90:] == pytest.approx(1.0)


@pytest.mark.check
def test_only_what_lies_before_a_head_is_mixed_as_seen() -> None:
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
