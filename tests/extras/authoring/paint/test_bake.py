"""Baked textures: every texel has the colour of its place on the surface, and no lookup finds an unpainted one."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.bake import bake
from glsplat.extras.authoring.paint.texels import texels_of
from glsplat.meshes import RiggedMesh
from tests.extras.authoring.paint.scene import photographed


@cache
def person() -> RiggedMesh:
    return photographed("front").mesh


def by_place(points: SurfacePoints) -> np.ndarray:
    """[M, 3] a colour that changes with the place, never near white or black."""
    where = points.at(person().vertices)
    return np.asarray(0.45 + 0.15 * np.sin(where * 9 + (0, 1, 2)))


def test_texels_map_to_their_surface_points() -> None:
    corners = np.random.default_rng(1).uniform(0.01, 0.3, (9, 3, 2)) + np.stack(
        np.meshgrid(np.arange(3) / 3, np.arange(3) / 3), axis=-1
    ).reshape(9, 1, 2)
    width, height = 64, 48
    found = texels_of(corners, width, height)
    rows, columns = np.divmod(found.index, width)
    there = np.einsum("mk,mkc->mc", found.weights, corners[found.face])
    assert np.abs(there - np.stack([(columns + 0.5) / width, 1 - (rows + 0.5) / height], axis=1)).max() < 1e-9
    assert len(np.unique(found.index)) == len(found.index)
    inside = []  # by the signs of the edges, one texel after the other
    for index in range(width * height):
        row, column = divmod(index, width)
        at = np.array([(column + 0.5) / width, 1 - (row + 0.5) / height])
        ahead, to = np.roll(corners, -1, axis=1) - corners, at - corners
        sides = ahead[..., 0] * to[..., 1] - ahead[..., 1] * to[..., 0]
        inside += [index] * bool(((sides > 0).all(axis=1) | (sides < 0).all(axis=1)).any())
    assert sorted(found.index) == inside


def test_triangles_beyond_the_edge_and_without_area_are_skipped() -> None:
    corners = np.array([[[-0.5, 0.5], [0.5, 0.5], [0.5, 1.5]], [[0.1, 0.1], [0.2, 0.2], [0.3, 0.3]]])
    found = texels_of(corners, 16, 16)
    assert set(found.face) == {0} and found.index.min() >= 0 and found.index.max() < 256


def test_the_texture_shows_the_colours() -> None:
    size = 256
    mesh = bake(person(), by_place, size)
    assert [part.name for part in mesh.parts] == ["skin", "eyes", "mouth"]
    assert mesh.parts[0].texture.shape == (size, size, 4)
    rng = np.random.default_rng(0)
    for old, part in zip(person().parts, mesh.parts, strict=True):
        assert np.array_equal(old.faces, part.faces) and (part.texture[..., 3] == 255).all()
        face = rng.integers(0, len(part.faces), 3000)
        weights = rng.dirichlet([1, 1, 1], 3000)
        shown = part.sample(np.einsum("mk,mkc->mc", weights, part.uv[face]))[:, :3]
        right = by_place(SurfacePoints(part.faces[face].astype(np.intp), weights))
        assert np.abs(shown - right).mean() < 0.004
        assert np.abs(shown - right).max() < 0.15


def test_a_texture_size_out_of_bounds_is_refused() -> None:
    for size in (0, 15, 8193):
        with pytest.raises(FormatError, match="16 to 8192 texels"):
            bake(person(), by_place, size)
