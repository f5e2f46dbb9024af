"""Measures of levels of detail: PSNR of pictures, and the density up to which a level is used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.camera import Camera, pinhole
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.finish.level_measure import MeasureConfig, box_psnr, measured
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.renderer.levels import Proxy
from glsplat.splats import Splats
from tests.scenes import cloud, limb

pytestmark = [pytest.mark.usefixtures("gl"), pytest.mark.gl]
QUICK = MeasureConfig(directions=2, inside=1, size=160)


def test_psnr_is_over_the_covered_box() -> None:
    picture = np.zeros((100, 100, 4), np.float32)
    picture[40:50, 40:60] = 1
    other = picture.copy()
    other[40:50, 40:60, :3] = 0.9
    assert box_psnr(picture, other) == pytest.approx(20, abs=1e-4)
    assert box_psnr(picture, picture) == 120
    assert box_psnr(np.zeros_like(picture), np.zeros_like(picture)) == 120
    gone = np.zeros_like(picture)
    gone[40:50, 40:50] = picture[40:50, 40:50]
    assert box_psnr(picture, gone) == pytest.approx(-10 * np.log10(0.5), abs=1e-4)  # the box is that of both


def test_the_measured_psnr_holds_in_the_renderer(context: Context) -> None:
    """A picture from elsewhere, at the measured density, keeps about the measured PSNR."""
    finest = cloud(600, spread=0.3)
    blurred = replace(finest.take(np.arange(599)), scales=finest.scales[:599] * np.float32(1.06))
    (level,) = measured(finest, [blurred], replace(QUICK, psnr=34, size=400), context=context)
    assert level.psnr is not None and 34 <= level.psnr < 60
    proxy = Proxy.of(finest)
    eye = np.eye(4)
    eye[2, 3] = 7.0
    camera = Camera(eye, pinhole(300, 300, 60), 300, 300)
    focal = level.density / proxy.density(camera) * camera.K[0, 0]
    camera = Camera(eye, [[focal, 0, 150], [0, focal, 150], [0, 0, 1]], 300, 300)
    pictures = []
    for scene in (finest, blurred):
        with Renderer(scene, size=(300, 300), context=context) as renderer:
            pictures.append(renderer.render([camera])[0].astype(np.float32) / 255)
    assert box_psnr(*pictures) > 33


def test_a_level_as_good_as_a_finer_one_replaces_it(context: Context) -> None:
    base = limb(300)
    opacities = base.splats.opacities.copy()
    opacities[100:] = 0
    finest = replace(base, splats=replace(base.splats, opacities=opacities))

    def few(count: int) -> object:
        return replace(finest, splats=finest.splats.take(np.arange(count)), skin=finest.skin.take(np.arange(count)))

    levels = measured(finest, [few(200), few(100)], QUICK, context=context)  # type: ignore[list-item]
    assert [len(level.content.splats) for level in levels] == [100]
    again = measured(finest, [few(200), few(100)], QUICK, context=context)  # type: ignore[list-item]
    assert [level.density for level in levels] == [level.density for level in again]
    assert replace(finest, levels=levels).levels == levels


def test_nothing_to_measure(context: Context) -> None:
    nothing = Splats.create([[np.nan] * 3], [[1, 0, 0, 0]], [[1, 1, 1]], [1], rgb=[[1, 1, 1]])
    with pytest.raises(GlsplatError, match="at least one finite splat"):
        measured(nothing, [nothing], QUICK, context=context)
    assert measured(cloud(50), [], QUICK, context=context) == ()


def test_black_splats_differ_before_grey() -> None:
    picture = np.zeros((8, 8, 4), np.float32)
    picture[..., 3] = 1
    assert box_psnr(picture, 0 * picture) == pytest.approx(-10 * np.log10(0.25), abs=1e-4)
