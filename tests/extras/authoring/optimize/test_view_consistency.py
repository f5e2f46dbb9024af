"""Values gathered from pictures, against the drawing of colours and its gradients."""

from __future__ import annotations

import numpy as np

from glsplat.camera import Camera, look_at, pinhole
from glsplat.extras.authoring.geometry.posed import PosedSplats, placed
from glsplat.extras.authoring.optimize.rasterizer import Rasterizer
from glsplat.extras.authoring.optimize.view_consistency import SUMS, gather_visible
from tests.scenes import cloud

VIEW = Camera(look_at((0.3, 1, 3), (0, 0, 0)), pinhole(150, 90), 150, 90)


def twin(splats: PosedSplats, values: np.ndarray, towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[N, 7] by pictures of three values each, as colours are drawn, and [N] weights."""
    by_colour = Rasterizer(len(values), threads=1)

    def drawn(columns: list[int]) -> np.ndarray:
        rgb = np.ascontiguousarray(values[:, columns], np.float64)
        return by_colour.draw(splats._replace(rgb=rgb), VIEW, True)[:, :, :3].copy()

    shown = np.concatenate([drawn([0, 1, 2]), drawn([3, 4, 5])], axis=2)
    part = shown[:, :, 5:]
    good = (part > 0.5).astype(np.float32)
    seen = shown[:, :, :5] / np.maximum(part, 0.5)
    upright = np.clip(seen[:, :, :3] @ towards, 0, 1)[:, :, None] ** 2 * good
    pictures = np.concatenate([seen * upright, upright, good, 0 * good], axis=2).astype(np.float32)
    sums = []
    for k in range(0, 8, 4):
        found = by_colour.backward(np.ascontiguousarray(pictures[:, :, k : k + 4]), np.ones(part.shape[:2], np.float32))
        sums.append(np.column_stack([found.rgb, found.error]).copy())
        fourth = by_colour.backward(np.zeros_like(pictures[:, :, :4]), pictures[:, :, k + 3])
        sums[-1][:, 3] = fourth.error
    whole = by_colour.weights()
    return np.column_stack([*sums])[:, :7], whole


def sums(splats: PosedSplats, values: np.ndarray, towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[N, SUMS], and [N] how much of the picture each splat makes."""
    count = len(values)
    drawing = Rasterizer(count + 100)
    drawing.place(splats, VIEW, True)
    shares, found = drawing.shares(), np.empty((count, SUMS))
    gather_visible(*shares, VIEW.width * VIEW.height, values.astype(np.float32), towards.astype(np.float32), found)
    return found, np.bincount(np.repeat(shares.splat, np.diff(shares.first)), shares.weight, count)


def test_sums_equal_those_of_pictures_of_the_values() -> None:
    splats = placed(cloud(400))
    rng = np.random.default_rng(5)
    values = rng.normal(size=(400, 6))
    values[:, :3] = -VIEW.viewmat[2, :3] + 0.5 * rng.normal(size=(400, 3))
    values[:, 5] = 1
    values[::3] = 0  # these face away
    towards = -VIEW.viewmat[2, :3]
    found, weights = sums(splats, values, towards)
    wanted, whole = twin(splats, values, towards)
    assert found.shape == (400, SUMS)
    assert np.abs(wanted[:, 6]).max() > 3 and np.abs(wanted[:, 0]).max() > 0.5
    assert np.allclose(found, wanted, rtol=2e-3, atol=2e-3)
    assert np.allclose(weights, whole, rtol=1e-4, atol=1e-4)


def test_shares_sum_to_the_picture_and_end_at_min_transmittance() -> None:
    splats = placed(cloud(400))
    counts = []
    for least in (0.4, 1e-4):
        drawing = Rasterizer(400, min_transmittance=least)
        drawing.place(splats, VIEW, True)
        shares = drawing.shares()
        picture = np.bincount(shares.pixel, shares.weight, VIEW.width * VIEW.height).reshape(VIEW.height, VIEW.width)
        assert 0.6 < picture.max() < 1 and (np.diff(shares.first) > 0).all()
        assert np.allclose(picture, drawing.draw(splats, VIEW, True)[:, :, 3], atol=1e-5)
        counts.append(len(shares.pixel))
    assert counts[0] < counts[1] == shares.first[-1]
