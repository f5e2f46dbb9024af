"""Find a mark in rendered pictures after attacks, and none where there is none."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.metrics import flip
from glsplat.extras.watermark import detect as detecting
from glsplat.extras.watermark.detect import ALARM, WINDOW, detect
from glsplat.extras.watermark.mark import Watermark
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from tests.extras.watermark.attacks import ATTACKS

KEY, OTHER = b"sixteen bytes 01", b"sixteen bytes 02"
SIDE = 448
HEAD = slice(4, 210), slice(108, 350)  # and shoulders
Pictures = NDArray[np.uint8]  # [T, H, W, 4]


@pytest.fixture(scope="module")
def clips(context: Context) -> tuple[Pictures, Pictures, Watermark]:
    """Somebody waving, from the waist up: without a mark, with it, and the mark."""
    avatar, mark = default_avatar(), Watermark(0x1A2B, 0x00C0FFEE, KEY)
    motion = load_embedded_motion("wave-and-turn", avatar.skeleton)
    eyes = stereo_cameras(head_matrix((0, 0.35, 1.0), (0, 0, 0, 1)), size=(SIDE, SIDE))[:1]
    plain, marked = [], []
    with context.ctx, Renderer(avatar, size=(SIDE, SIDE), context=context) as renderer:
        for frame in range(WINDOW):
            pose = motion.pose(frame)
            for step, pictures in ((None, plain), (mark, marked)):
                renderer.step = step
                pictures.append(renderer.render(eyes, pose)[0])
    return np.stack(plain), np.stack(marked), mark


@pytest.mark.gl
@pytest.mark.check
@pytest.mark.parametrize("name", ["0.75x", "crop", "x264"])
def test_a_mark_is_found(clips: tuple[Pictures, Pictures, Watermark], name: str) -> None:
    plain, marked, mark = clips
    attack = ATTACKS[name]
    found = detect(attack(marked[..., :3], HEAD), KEY)
    assert found is not None and (found.server, found.session) == (mark.server, mark.session)
    assert found.chance <= ALARM and found.frames == WINDOW
    assert abs(found.scale / (0.75 if name == "0.75x" else 1) - 1) < 0.02
    if name == "crop":
        assert detect(attack(plain[..., :3], HEAD), KEY) is None
        assert detect(attack(marked[..., :3], HEAD), OTHER) is None


@pytest.mark.check
@pytest.mark.gl
def test_it_is_not_seen(clips: tuple[Pictures, Pictures, Watermark]) -> None:
    plain, marked, _ = clips
    for index in (0, WINDOW // 2):
        off = (marked[index].astype(float) - plain[index])[..., :3]
        there = plain[index, ..., 3] > 127
        assert 0.2 < there.mean() < 0.6
        assert 42 < 10 * np.log10(255**2 / (off[there] ** 2).mean()) < 50  # dB, where the avatar is
        assert flip(marked[index, ..., :3] / 255, plain[index, ..., :3] / 255) <= 0.02


@pytest.mark.check
@pytest.mark.gl
def test_windows_and_what_is_left_over(clips: tuple[Pictures, Pictures, Watermark]) -> None:
    plain, marked, mark = (*(pictures[:, *HEAD] for pictures in clips[:2]), clips[2])
    late = detect(np.concatenate([plain, marked[:7]]), KEY)  # in the second search, of seven pictures
    assert late is not None and (late.session, late.frames) == (mark.session, 7)
    assert late.chance / detect(marked[:7], KEY).chance == pytest.approx(3)  # 2 (2 + 1) instead of 1 (1 + 1)
    assert detecting._chance(8.0, 10**6) / (1e6 * np.exp(-32) / 2**16) == pytest.approx(1)  # as detect.py derives it
    grey = cv2.cvtColor(marked[0], cv2.COLOR_RGBA2GRAY)
    assert detect([grey], KEY).session == detect([marked[0, ..., :3]], KEY).session == mark.session


def test_nothing_to_find_in_nothing() -> None:
    flat = np.full((2, 40, 50, 3), 90, np.uint8)
    assert detect(flat, KEY) is None and detect(flat[:, :1, :1], KEY) is None
    for frames, message in (
        ([], "at least 1 picture"),
        ([flat[0], flat[0, :20]], "one size are needed, not 50x40 and then 50x20"),
        ([flat[0].astype(np.float32)], "pictures of uint8"),
        ([flat[0, ..., :2]], r"not \(40, 50, 2\)"),
    ):
        with pytest.raises(GlsplatError, match=message):
            detect(frames, KEY)
    with pytest.raises(GlsplatError, match="a window needs at least 1 picture"):
        detect(flat, KEY, window=0)
