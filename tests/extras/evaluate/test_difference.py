"""The report's errors are those one computes by hand, and nothing but a known fault moves them."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.difference import PSNR_CAP, Difference, pareto, reference_pictures
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.splats import Splats
from tests.scenes import cloud, one_splat

pytest.importorskip("flip_evaluator")

SIZE, DISTANCE = 64, 3.0
VIEW = Camera(look_at((0, 0, DISTANCE), (0, 0, 0)), pinhole(SIZE, SIZE), SIZE, SIZE)
PIXEL = DISTANCE / VIEW.K[0, 0]
"""Metres of a pixel at the origin."""

EXACT = RenderConfig(target="32f", output="float32")


def measured(context: Context, drawn: Splats, right: Splats) -> Difference:
    """Return the difference of a picture of ``drawn`` from ``right`` in float64, seen by one camera."""
    with Renderer(drawn, size=(SIZE, SIZE), config=EXACT, context=context) as renderer:
        return Difference.of(renderer.render([VIEW]), reference_pictures(right, [VIEW], None))


@pytest.mark.gl
def test_without_a_fault_nothing_is_reported(context: Context) -> None:
    row = measured(context, cloud(200), cloud(200))
    assert row.psnr > 80 and row.maximum < 5e-3 and (row.flip or 0) < 1e-3


@pytest.mark.gl
def test_a_splat_shifted_by_a_pixel(context: Context) -> None:
    """The integral of the squared difference of two Gaussians one pixel apart, of opacity o and deviation s:
    2 pi s^2 o^2 (1 - exp(-1 / (4 s^2))), times the squares of the colour."""
    deviation, opacity, colour = 5.0, 0.8, np.array([1.0, 0.2, 0.1])
    metres = np.sqrt(deviation**2 - 0.3) * PIXEL  # the projection adds 0.3 px^2
    right = one_splat(scales=[[metres] * 3], opacities=[opacity], rgb=[colour])
    shifted = one_splat(scales=[[metres] * 3], opacities=[opacity], rgb=[colour], means=[[PIXEL, 0, 0]])
    squares = 2 * np.pi * deviation**2 * opacity**2 * (1 - np.exp(-1 / (4 * deviation**2)))
    psnr = -10 * np.log10(squares * (colour**2).sum() / (3 * SIZE * SIZE))
    # the steepest slope of a Gaussian is o exp(-1/2) / s
    steepest = opacity * np.exp(-0.5) / deviation
    row = measured(context, shifted, right)
    assert row.psnr == pytest.approx(psnr, abs=0.05)
    assert row.maximum == pytest.approx(steepest, rel=0.02)
    assert row.flip is not None and row.flip > 10 * (measured(context, right, right).flip or 0)


@pytest.mark.gl
def test_two_splats_drawn_in_the_wrong_order(context: Context) -> None:
    """a over b less b over a is a b (colour of a - colour of b); alpha is the same either way."""
    a, b = 0.7, 0.4
    red, blue = np.array([0.9, 0.1, 0.2]), np.array([0.2, 0.3, 0.8])

    def pair(nearer: float) -> Splats:  # both fill the screen; which one is nearer is all that differs
        means = [[0, 0, nearer], [0, 0, -nearer]]
        return Splats.create(means, [[1.0, 0, 0, 0]] * 2, [[500.0] * 3] * 2, [a, b], rgb=[red, blue])

    difference = a * b * (red - blue)
    row = measured(context, pair(-0.1), pair(0.1))
    assert row.maximum == pytest.approx(np.abs(difference).max(), rel=1e-3)
    assert row.psnr == pytest.approx(-10 * np.log10((difference**2).mean()), abs=0.01)


def test_difference_by_hand() -> None:
    expected = np.zeros((1, 16, 16, 4))
    image = expected.copy()
    image[0, 3, 4] = 0.5, 0, 0, 0.25
    d = Difference.of(image, expected)
    assert d.psnr == pytest.approx(-10 * np.log10(0.25 / (3 * 256)), abs=1e-3)
    assert d.maximum == 0.5 and d.mean == pytest.approx(0.75 / 1024) and d.beyond == 1 / 256
    assert d.flip is not None and d.flip > 0 and not d.contract
    assert Difference.of(expected, expected) == Difference(PSNR_CAP, 0.0, 0.0, 0.0, 0.0)
    image[0, 0, 0, 0] = np.nan
    assert Difference.of(image, expected, flip=False).maximum == 1e3
    with pytest.raises(GlsplatError, match="one shape"):
        Difference.of(image[:, :8], expected)
    worst = Difference.worst([d, Difference(30.0, 0.0, 0.9, 0.0, None)])
    assert worst.psnr == min(30.0, d.psnr) and worst.maximum == 0.9 and worst.flip == d.flip


def test_pareto_by_hand() -> None:
    points = [(3.0, 50.0), (1.0, 30.0), (2.0, 30.0), (2.5, 40.0), (3.0, 45.0), (4.0, 50.0)]
    assert pareto(points) == [1, 3, 0]
    assert pareto([]) == []
