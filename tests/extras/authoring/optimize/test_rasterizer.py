"""The compiled rasterizer against footprints.py in numpy, on any number of threads."""

from __future__ import annotations

import gc
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glsplat import reference
from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import RenderConfig
from glsplat.extras.authoring.geometry.footprints import Footprints, footprints
from glsplat.extras.authoring.geometry.posed import PosedSplats, placed
from glsplat.extras.authoring.optimize.rasterizer import Gradients, Rasterizer
from glsplat.splats import Splats
from tests.extras.authoring.optimize.figures import decibel
from tests.scenes import camera, cloud, one_splat

VIEW = Camera(
    look_at((0.3, 1, 3), (0, 0, 0)), pinhole(230, 150), 230, 150
)  # four tiles by three, not all of them whole
AMONG = Camera(look_at((0.2, 0.1, 0.4), (0, 0, 0)), pinhole(230, 150, 70), 230, 150, near=0.05)


def smooth(view: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return a slope by the picture, and its error."""
    y, x = np.mgrid[: view.height, : view.width].astype(np.float32)
    slope = np.stack([np.sin(x / 9 + k) + np.cos(y / 7 - k) for k in range(4)], axis=-1)
    return slope, np.abs(slope[..., 0]) + np.float32(0.5)


def crowd() -> Splats:
    """Return splats, some of them opaque: capped opacities have no slope."""
    splats = cloud(600)
    return replace(splats, opacities=np.where(np.arange(600) % 5, splats.opacities, 1.0))


def large() -> Splats:
    """Return splats around the camera: many lie far outside the picture and reach into it."""
    splats = cloud(60)
    return replace(splats, scales=splats.scales * 6)


def needles() -> Splats:
    """Return splats ten thousand times as long as wide."""
    splats = cloud(200)
    return replace(splats, scales=np.tile([0.5, 5e-5, 5e-5], (200, 1)) * np.exp(splats.means[:, :1]))


def twin(splats: PosedSplats, view: Camera, antialias: bool) -> Footprints:
    return footprints(*splats[:4], view, antialias=antialias)


def slopes(prints: Footprints, splats: PosedSplats, view: Camera) -> dict[str, np.ndarray]:
    """Return the gradients of footprints.py."""
    slope, error = smooth(view)
    found = prints.backward(slope.astype(np.float64), splats.rgb, splats.opacities, splats.scales)
    weight = prints.alpha * prints.transmittance
    return {
        "means": found.means,
        "log_scales": found.log_scales,
        "turns": found.turns,
        "exponents": found.opacities * splats.opacities,
        "rgb": found.rgb,
        "weight": found.weight,
        "error": np.bincount(prints.splat, weight * error.reshape(-1)[prints.pixel], minlength=prints.count),
    }


@pytest.mark.parametrize(
    ("scene", "view", "antialias", "off"),
    [
        (crowd, VIEW, True, 3e-3),  # what passes less than a ten thousandth is not drawn
        (needles, VIEW, False, 2e-3),
        (large, AMONG, True, 1e-4),
        (large, AMONG, False, 1e-4),
    ],
)
def test_pictures_and_slopes_equal_footprints(scene: Any, view: Camera, antialias: bool, off: float) -> None:
    splats = placed(scene())
    drawing = Rasterizer(len(splats.means))
    picture, prints = drawing.draw(splats, view, antialias), twin(splats, view, antialias)
    assert picture[..., 3].max() > 0.01 and decibel(picture, prints.picture(splats.rgb)) > 95
    found = drawing.backward(*smooth(view))
    for name, expected in slopes(prints, splats, view).items():
        missed = np.linalg.norm(getattr(found, name) - expected) / np.linalg.norm(expected)
        assert missed < off, (name, missed)
    np.testing.assert_allclose(drawing.weights(), prints.backward(*zeros(splats)).weight, rtol=3e-3, atol=1e-4)


def zeros(splats: PosedSplats) -> tuple[np.ndarray, ...]:
    return np.zeros((VIEW.height, VIEW.width, 4)), splats.rgb, splats.opacities, splats.scales


def test_many_layers_end_at_a_transmittance_of_1e_4() -> None:
    splats = placed(cloud(20_000))
    picture = Rasterizer(20_000).draw(splats, VIEW, antialias=False)
    off = np.abs(picture - twin(splats, VIEW, antialias=False).picture(splats.rgb))
    assert 1e-6 < off.max() < 1.1e-4 and decibel(off, np.zeros(1)) > 90


def answer(splats: PosedSplats, threads: int, times: int = 1) -> list[bytes]:
    drawing = Rasterizer(len(splats.means), threads)
    out = []
    for _ in range(times):
        out += [drawing.draw(splats, VIEW, antialias=True).tobytes()]
        drawing.backward(*smooth(VIEW))
        out += [drawing.out.tobytes()]
        drawing.draw(splats._replace(scales=splats.scales * 3), camera(40), antialias=False)  # leaves nothing behind
        drawing.backward(*smooth(camera(40)))
    return out


def test_any_number_of_threads_gives_the_same_bytes() -> None:
    splats = placed(cloud(3000))
    once = answer(splats, 1)
    assert once == answer(splats, 2) == answer(splats, 3) and answer(splats, 2, times=2) == once * 2


def test_threads_end_with_the_rasterizer() -> None:
    before = set(threading.enumerate())
    drawing = Rasterizer(9, threads=3)
    drawing.draw(placed(cloud(9)), VIEW, antialias=False)
    own = set(threading.enumerate()) - before
    assert own and all(thread.name.startswith("glsplat-fit") for thread in own)
    del drawing
    gc.collect()
    for thread in own:
        thread.join(60)
    assert not any(thread.is_alive() for thread in own)


TURNED = [[0.5, 0.3, 0.2, 0.7]]


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize(
    ("changes", "shown"),
    [
        ({}, True),
        ({"means": [[0.0, 0, 5]]}, False),  # behind
        ({"means": [[0.0, 0, 2.995]]}, False),  # nearer than near
        ({"means": [[50.0, 0, 0]]}, False),  # beside the picture
        ({"means": [[1.35, 0, 0]]}, True),  # half beside
        ({"scales": [[0.1, 0.1, 1e-12]]}, True),
        ({"scales": [[1e4, 1e-2, 1e-2]], "quats": TURNED}, True),
        ({"scales": [[-0.1, 0.2, 0.05]], "quats": TURNED}, True),  # the sign is without meaning
        ({"scales": [[1e6, 1e6, 1e6]]}, True),
        ({"opacities": [0.003]}, False),
        ({"opacities": [7.0]}, True),  # as 1
        ({"rgb": [[1.5, -0.4, 0.5]]}, True),  # as 1 and 0
    ],
)
def test_one_splat_follows_the_pixel_contract(changes: dict[str, Any], shown: bool, antialias: bool) -> None:
    splat, view = one_splat(**changes), camera(64)
    drawing = Rasterizer(1)
    picture = drawing.draw(placed(splat), view, antialias)
    truth = reference.render(splat, [view], config=RenderConfig(antialias=antialias))[0]
    if "rgb" in changes:
        truth = np.clip(truth, 0, truth[..., 3:])
    assert np.abs(picture - truth).max() < 3e-5 and (picture.max() > 0.003) == shown
    drawing.backward(*smooth(view))
    assert np.isfinite(drawing.out).all() and drawing.out.any() == shown


def found(splats: PosedSplats) -> tuple[np.ndarray, Gradients]:
    drawing = Rasterizer(len(splats.means))
    picture = drawing.draw(splats, VIEW, antialias=True)
    return picture, drawing.backward(*smooth(VIEW))


def expect_all_but_the_seventh(splats: PosedSplats, others: PosedSplats) -> None:
    (picture, gradients), (truth, expected) = found(splats), found(others)
    assert picture.any() and picture.tobytes() == truth.tobytes()
    for mine, theirs in zip(gradients, expected, strict=True):
        assert not mine[7].any() and np.array_equal(np.delete(mine, 7, axis=0), theirs)


@pytest.mark.parametrize("value", [np.nan, -np.inf])
@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "sh"])
def test_splats_that_are_not_finite_are_not_drawn(name: str, value: float) -> None:
    scene = cloud(50)
    broken = getattr(scene, name).copy()
    broken[7, ...] = value
    expect_all_but_the_seventh(placed(replace(scene, **{name: broken})), placed(scene.take(np.arange(50) != 7)))


@pytest.mark.parametrize(
    ("name", "value"),
    [("opacities", 0.0), ("opacities", np.nan), *(("means", value) for value in (np.nan, np.inf, -np.inf))],
)
def test_invalid_splats_are_not_drawn(name: str, value: float) -> None:
    scene = cloud(50)
    splats = placed(scene)
    getattr(splats, name)[7] = value
    expect_all_but_the_seventh(splats, placed(scene.take(np.arange(50) != 7)))


def test_no_splats() -> None:
    drawing = Rasterizer(0)
    assert not drawing.draw(placed(cloud(0)), VIEW, antialias=False).any()
    assert all(len(one) == 0 for one in drawing.backward(*smooth(VIEW)))
