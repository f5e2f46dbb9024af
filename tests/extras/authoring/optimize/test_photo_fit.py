"""Fits of splats to their photographs, and elsewhere to the painted body."""

from __future__ import annotations

import importlib
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.posed import placed, posed_splats
from glsplat.extras.authoring.optimize.photo_fit import _picture, fitted_to_photos
from glsplat.extras.authoring.optimize.rasterizer import Rasterizer
from glsplat.extras.authoring.optimize.target_pictures import ViewConfig
from glsplat.extras.authoring.paint.bake import Colours
from glsplat.extras.authoring.paint.painter import painter_of
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.extras.authoring.sample.scatter import scatter
from tests.extras.authoring.optimize.without import without_numba
from tests.extras.authoring.paint.scene import Scene, photographed

module = importlib.import_module("glsplat.extras.authoring.optimize.photo_fit")


def silent(stage: str, done: float) -> None: ...


FEW = {"body": 6, "poses": 1, "each": 1, "size": 160, "close": 64}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return photographed("front")


@pytest.fixture(scope="module")
def painted(scene: Scene) -> tuple[Avatar, Colours]:
    """Return the painted avatar and the colours."""
    rng = np.random.default_rng(0)
    strewn = scatter(scene.mesh, 4000, rng)
    painter = painter_of(scene.body, scene.shots, strewn.points)
    first = painter.paint(strewn.points)
    return strewn.avatar(scene.mesh, first.rgb, first.detail, rng), painter.colours


def drawn(avatar: Avatar, picture: Any) -> np.ndarray:
    splats = posed_splats(avatar, picture.pose)
    return Rasterizer(len(splats)).draw(placed(splats), picture.camera, splats.antialias)


def missed(avatar: Avatar, picture: Any) -> float:
    """Return the RMS error where the photograph is trusted."""
    away = (drawn(avatar, picture) - picture.target / 255)[picture.trust > 0]
    return float(np.sqrt((away**2).mean()))


def cut(shot: FittedPicture) -> np.ndarray:
    """The mask, as far as it reaches."""
    rows, columns = (np.flatnonzero(shot.mask.any(axis=axis)) for axis in (1, 0))
    return shot.mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def off(alpha: np.ndarray, mask: np.ndarray) -> float:
    """Pixels that the avatar stands beside the mask."""
    shift, _ = cv2.phaseCorrelate(alpha.astype(np.float64), mask.astype(np.float64))
    return float(np.abs(shift).max())


def test_a_photograph_aligns_with_the_avatar(scene: Scene, painted: tuple[Avatar, Colours]) -> None:
    shot = scene.shots[0]
    picture, mask = _picture(painted[0], shot), cut(shot)
    assert picture.target.shape == (*mask.shape, 4) and (picture.target[..., 3] == 255).all()
    assert not picture.trust[~mask].any() and 0.4 < picture.trust.sum() / mask.sum() < 0.9
    inner = cv2.erode(mask.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    assert np.array_equal(picture.trust[8:-8, 8:-8] > 0, inner[8:-8, 8:-8])  # four pixels inside the outline
    alpha = drawn(painted[0], picture)[..., 3]
    assert alpha[picture.trust > 0].mean() > 0.97
    assert off(alpha, mask) < 0.5
    assert picture.metres_per_pixel == pytest.approx(shot.view.pelvis[2] / shot.focal)


def test_large_photographs_are_resampled(scene: Scene, painted: tuple[Avatar, Colours], monkeypatch) -> None:
    whole = _picture(painted[0], scene.shots[0])
    monkeypatch.setattr(module, "_PERSON_HEIGHT_PX", 300)
    small = _picture(painted[0], scene.shots[0])
    scale = small.target.shape[0] / whole.target.shape[0]
    assert small.target.shape[0] == pytest.approx(300, abs=2) and scale < 0.7
    assert small.metres_per_pixel == pytest.approx(whole.metres_per_pixel / scale, rel=0.01)
    height, width = small.target.shape[:2]
    mask = cv2.resize(cut(scene.shots[0]).astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    assert off(drawn(painted[0], small)[..., 3], mask) < 1
    assert missed(painted[0], small) < 1.2 * missed(painted[0], whole)


@pytest.mark.check
@pytest.mark.gl
def test_the_fit_reproduces_the_photograph(
    scene: Scene, painted: tuple[Avatar, Colours], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in FEW.items():
        monkeypatch.setitem(ViewConfig.__init__.__kwdefaults__, name, value)
    monkeypatch.setattr(module, "_TEXTURE_PX", 256)
    told: list[str] = []
    avatar, colours = painted
    done = fitted_to_photos(
        avatar, scene.mesh, colours, scene.shots, 0, 60, lambda stage, _: told.append(stage.partition(",")[0])
    )
    picture = _picture(avatar, scene.shots[0])
    assert missed(done, picture) < 0.8 * missed(avatar, picture)
    assert len(done.splats) == len(avatar.splats) and np.isfinite(done.splats.means).all()
    assert list(dict.fromkeys(told)) == ["painting the body", "drawing target pictures", "fitting splats"]


def test_zero_steps_change_nothing(scene: Scene, painted: tuple[Avatar, Colours]) -> None:
    avatar, colours = painted
    assert fitted_to_photos(avatar, scene.mesh, colours, scene.shots, 0, 0, silent) is avatar


def test_without_numba_only_colours_are_fitted(
    scene: Scene, painted: tuple[Avatar, Colours], monkeypatch: pytest.MonkeyPatch
) -> None:
    without_numba(monkeypatch)
    avatar, colours = painted
    monkeypatch.setattr(module, "fit_colours", lambda *words: words)
    made = fitted_to_photos(avatar, scene.mesh, colours, scene.shots, 0, 200, silent)
    assert made == (avatar, scene.shots, 8)
