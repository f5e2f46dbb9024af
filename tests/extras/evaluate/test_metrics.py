"""L1, PSNR, SSIM and FLIP: figures computed by hand, and those of other people's programs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.metrics import decibel, flip, l1, psnr, ssim, ssim_map

BOX = (slice(10, 31), slice(3, 60))


def grey(values: Any) -> np.ndarray:
    """A picture of one tone a column, 20 rows."""
    return np.broadcast_to(np.asarray(values, np.float32)[None, :, None], (20, len(values), 3)).copy()


def noisy(rng: np.random.Generator, shape: tuple[int, int] = (50, 64)) -> tuple[np.ndarray, np.ndarray]:
    truth = rng.random((*shape, 3))
    return np.clip(0.7 * truth + 0.2 * rng.random((*shape, 3)), 0, 1), truth


def test_a_shift_by_a_pixel() -> None:
    """An edge that moves by a pixel makes one column of 80 wrong; a ramp becomes wrong everywhere, by its slope."""
    edge = grey(np.arange(80) >= 40)
    moved = grey(np.arange(80) >= 41)
    assert l1(moved, edge) == pytest.approx(1 / 80) and psnr(moved, edge) == pytest.approx(10 * np.log10(80))
    assert l1(moved, edge, (slice(None), slice(30, 50))) == pytest.approx(1 / 20)
    ramp = grey(np.arange(80) / 100)
    later = grey(np.arange(1, 81) / 100)
    assert l1(later, ramp) == pytest.approx(0.01, rel=1e-5) and psnr(later, ramp) == pytest.approx(40, abs=1e-4)


def test_a_wrong_gamma() -> None:
    """All tones alike often: the integrals of |x^a - x| and of its square over 0..1."""
    tones = (np.arange(4096) + 0.5) / 4096
    a = 1 / 2.2
    picture = grey(tones**a)
    assert l1(picture, grey(tones)) == pytest.approx(1 / (a + 1) - 1 / 2, abs=1e-5)
    square = 1 / (2 * a + 1) - 2 / (a + 2) + 1 / 3
    assert psnr(picture, grey(tones)) == pytest.approx(-10 * np.log10(square), abs=1e-3)


def test_equal_pictures(rng: np.random.Generator) -> None:
    _, truth = noisy(rng)
    assert l1(truth, truth) == 0 and psnr(truth, truth) == 120 and psnr(truth, truth, most=160) == 160
    assert ssim(truth, truth) == pytest.approx(1) and decibel(0.01) == pytest.approx(20)


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_ssim_is_that_of_scikit_image(rng: np.random.Generator, kind: type) -> None:
    structural_similarity = pytest.importorskip("skimage.metrics").structural_similarity
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1}
    for _ in range(2):
        picture, truth = (one.astype(kind) for one in noisy(rng))
        exact = (picture.astype(np.float64), truth.astype(np.float64))
        whole, full = structural_similarity(*exact, channel_axis=2, full=True, **options)
        assert ssim(picture, truth) == pytest.approx(whole, abs=1e-6)
        assert np.abs(ssim_map(picture, truth) - full).max() < 1e-6
        assert ssim(picture, truth, BOX) == pytest.approx(full[10:31, 5:59].mean(), abs=1e-6)  # not along the border


def test_ssim_knows_its_limits(rng: np.random.Generator) -> None:
    picture, truth = noisy(rng)
    with pytest.raises(GlsplatError, match="5 away from the border; this 64x50 picture has none"):
        ssim(picture, truth, (slice(0, 5), slice(None)))
    with pytest.raises(GlsplatError, match="this 10x50 picture has none"):
        ssim(picture[:, :10], truth[:, :10])
    assert ssim(picture[:11, :11], truth[:11, :11]) == pytest.approx(
        ssim_map(picture[:11, :11], truth[:11, :11])[5, 5].mean()
    )


def test_flip_is_its_authors_own(rng: np.random.Generator) -> None:
    flip_evaluator = pytest.importorskip("flip_evaluator")
    picture, truth = (one.astype(np.float32) for one in noisy(rng))
    errors, mean, _ = flip_evaluator.evaluate(truth, picture, "LDR", applyMagma=False)
    assert flip(picture, truth) == mean and flip(truth, truth) == 0
    assert flip(picture, truth, BOX) == pytest.approx(float(np.asarray(errors)[BOX].mean()), rel=1e-6)


@pytest.mark.parametrize("measure", [l1, psnr, ssim, flip])
def test_what_is_no_pair_of_pictures(rng: np.random.Generator, measure: Any) -> None:
    picture, truth = noisy(rng)
    broken = picture.copy()
    broken[3, 4, 1] = np.nan
    cases = [
        (picture[:-1], "need one shape, not"),
        ((picture * 255).astype(np.uint8), r"expected a picture of floats \[H, W, 3\]"),
        (picture * 1.5, r"expected a picture in \[0, 1\], got values from"),
        (broken, r"expected a picture in \[0, 1\], got values from nan"),
    ]
    for wrong, message in cases:
        with pytest.raises(GlsplatError, match=message):
            measure(wrong, truth)
    with pytest.raises(GlsplatError, match="expected a picture of floats"):
        measure(picture[..., 0], truth[..., 0])
