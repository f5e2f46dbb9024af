"""The mark in the resolve pass: the twin's picture, on the avatar alone, and nothing where none was asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.camera import Camera, stereo_cameras
from glsplat.errors import GlsplatError
from glsplat.extras.watermark.mark import Watermark, marked
from glsplat.extras.watermark.pattern import TILE
from glsplat.renderer import Renderer
from tests.scenes import cloud

Make = Callable[..., Renderer]
MARK = Watermark(7, 0xABCDEF, b"sixteen bytes 01")


def pair(width: int = 150, height: int = 100) -> list[Camera]:
    head = np.eye(4)
    head[2, 3] = 2.5
    return [replace(eye, background=(0.1, 0.0, 0.2)) for eye in stereo_cameras(head, 0.2, size=(width, height))]


def marked_by(renderer: Renderer, views: list[Camera], mark: Watermark = MARK) -> NDArray[Any]:
    renderer.step = mark
    try:
        return renderer.render(views)
    finally:
        renderer.step = None


def test_the_tile() -> None:
    tile = MARK.tile()
    assert tile.shape == (TILE, TILE) and abs(tile.mean()) < 1e-6 and abs(tile.std() - 1) < 1e-6
    spectrum = np.fft.fft2(tile)
    ring = np.hypot(*np.meshgrid(*[np.fft.fftfreq(TILE, 1 / TILE)] * 2))
    assert abs(spectrum[(ring < 5) | (ring > 18)]).max() < 1e-3 < abs(spectrum[(ring >= 5) & (ring <= 18)]).min()
    assert not np.array_equal(tile, Watermark(7, 0xABCDEE, MARK.key).tile())


@pytest.mark.gl
@pytest.mark.parametrize("cull_hidden", [False, True])
def test_pictures_are_those_of_the_twin(renderer_of: Make, cull_hidden: bool) -> None:
    scene, views = cloud(300), pair()
    if cull_hidden:
        scene = replace(scene, cones=np.full((len(scene), 4), (127, 0, 0, -127), np.int8))  # leaves out none
    exact = renderer_of(scene, size=(150, 100), views=2, cull_hidden=cull_hidden).render(views)
    renderer = renderer_of(scene, size=(150, 100), views=2, cull_hidden=cull_hidden, output="uint8")
    plain = renderer.render(views)
    drawn = marked_by(renderer, views)
    twin = np.floor(np.clip(marked(exact, MARK), 0, 1) * 255 + 0.5)
    assert abs(drawn - twin).max() <= 1 and (drawn != twin).mean() < 1e-3  # rounding at a half
    off = drawn[..., :3].astype(int) - plain[..., :3]
    assert abs(off).max() > 3 and np.array_equal(drawn[..., 3], plain[..., 3])
    nothing = plain[..., 3] == 0
    assert nothing.any() and not off[nothing].any()
    assert (drawn[..., :3] <= np.maximum(plain[..., :3], drawn[..., 3:])).all()
    assert np.array_equal(renderer.render(views), plain)  # and none is left behind
    np.testing.assert_array_equal(marked_by(renderer, views[1:])[0], drawn[1])  # a pair is two singles
    both = (off[..., 1] != 0).all(axis=0)
    tile = MARK.tile()[np.arange(100)[:, None] % TILE, np.arange(150) % TILE]
    assert both.sum() > 500  # both eyes have the same mark on the screen
    for eye in off[..., 1]:
        assert np.corrcoef(eye[both], tile[both])[0, 1] > 0.8


@pytest.mark.gl
def test_a_mark_is_for_bytes(renderer_of: Make) -> None:
    scene, views = cloud(5), pair()
    with pytest.raises(GlsplatError, match="a step is drawn into 8-bit pictures; use"):
        marked_by(renderer_of(scene, size=(150, 100)), views)
    for wrong in ("mark", 5, object(), Watermark):
        with pytest.raises(GlsplatError, match=r"a step needs source and tile\(\), as glsplat\.extras\.wat"):
            marked_by(renderer_of(scene, size=(150, 100), output="uint8"), views, wrong)  # type: ignore[arg-type]


@pytest.mark.gl
def test_tiles_are_kept_and_let_go(renderer_of: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glsplat.renderer.renderer.MAX_TEXTURES", 2)
    renderer, views = renderer_of(cloud(5), size=(150, 100), views=2, output="uint8"), pair()
    renderer.render(views)
    before = renderer.nbytes()["targets"]
    sizes = []
    for session in (1, 2, 1, 3, 4):
        marked_by(renderer, views, Watermark(1, session, MARK.key))
        sizes.append((renderer.nbytes()["targets"] - before) // (4 * TILE**2))
    assert sizes == [1, 2, 2, 2, 2]
