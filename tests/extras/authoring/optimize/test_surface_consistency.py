"""Normals and occlusion consistent with the visible surface: splats that show through a skin are lit as the skin."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.extras.authoring.optimize.surface_consistency import view_consistent
from glsplat.rotations import matrix_quaternions
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats
from tests.extras.authoring.optimize.without import without_numba

F64 = NDArray[np.float64]


def shell(radius: float, count: int) -> tuple[F64, F64]:
    """Points of a sphere about (0, 1, 0), evenly (Fibonacci), and where they face."""
    k = np.arange(count) + 0.5
    y, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ways = np.stack([np.sqrt(1 - y * y) * np.cos(turn), y, np.sqrt(1 - y * y) * np.sin(turn)], axis=1)
    return ways * radius + (0, 1, 0), ways


def cheek() -> tuple[Avatar, F64, F64, F64]:
    """Flat splats that leak a little, others that lie 4 mm behind them and face inwards, and ways outwards."""
    (first, out), (second, behind) = shell(0.2, 700), shell(0.196, 400)
    ways = np.concatenate([out, behind])
    aside = np.cross(ways, (0.3, 0.9, 0.2))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    axes = np.stack([aside, np.cross(ways, aside), ways], axis=2)
    scales = np.tile([0.011, 0.011, 0.001], (len(ways), 1))
    means, opacities = np.concatenate([first, second]), np.full(len(ways), 0.9)
    splats = Splats.create(means, matrix_quaternions(axes), scales, opacities, rgb=0.5 + 0 * ways)
    skeleton = Skeleton.from_joints(("base", "head"), [-1, 0], [[0, 0, 0], [0, 1, 0]])
    skin = Skin.create(np.ones((len(ways), 1), int), np.ones((len(ways), 1)), 2)
    normals = np.concatenate([out, -behind])
    occlusion = np.repeat([0.9, 0.25], [700, 400])
    return Avatar(splats, skeleton, skin), ways, normals, occlusion


def test_deviating_splats_take_the_visible_surface_and_visible_ones_stay() -> None:
    avatar, ways, normals, occlusion = cheek()
    found, opened, shade = view_consistent(avatar, normals, occlusion, np.repeat([0.5, 1.0], [700, 400]))
    before, after = ((some * ways).sum(axis=1) for some in (normals, found))
    outer = slice(0, 700)
    assert after[outer].min() > 0.95 and opened[outer].min() > 0.8
    level = np.abs(ways[:, 1]) < 0.7  # cameras stand around
    level[outer] = False
    assert (before[level] < -0.99).all() and (after[level] > 0.9).mean() > 0.95 and np.median(opened[level]) > 0.8
    assert np.allclose(np.linalg.norm(found, axis=1), 1)
    assert np.allclose(shade[outer], 0.5, rtol=0.1) and np.median(shade[level]) < 0.6
    unlit, _, ones = view_consistent(avatar, normals, occlusion)
    assert (ones == 1).all() and (unlit * found).sum(axis=1)[outer].min() > 0.95


def test_without_numba_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    avatar, _, normals, occlusion = cheek()
    without_numba(monkeypatch)
    same, opened, shade = view_consistent(avatar, normals, occlusion)
    assert same is normals and opened is occlusion and (shade == 1).all()
