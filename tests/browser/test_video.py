"""Video in Chromium: each picture of the server's is what the page shows, in its colours, also after a loss."""

from __future__ import annotations

import base64
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from glsplat.extras.far_links.video import CODECS, VideoStream
from glsplat.net.codec.encoded import Encoded
from glsplat.net.pages import page_files
from glsplat.net.server import ServerConfig
from tests.browser.conftest import OpenPage
from tests.browser.markers import offered
from tests.browser.stored import StoredPairs
from tests.browser.vr import enter, steer, visit

pytest.importorskip("av", reason="PyAV (glsplat[video]) is not installed")

DECODE = """async ([address, data, video, side]) => {
  const { VideoFrames } = await import(address);
  const frames = new VideoFrames();
  const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
  const how = { premultiplyAlpha: 'none', colorSpaceConversion: 'none' };
  const pictures = await frames.decode(bytes, video, side, how);
  return pictures.map((eye) => eye.map((bitmap) => {
    const canvas = new OffscreenCanvas(...side);
    const context = canvas.getContext('2d');
    context.drawImage(bitmap, 0, 0);
    return [...context.getImageData(0, 0, ...side).data];
  }));
}"""

HELD_BACK = """async ([address, sent]) => {
  const { VideoFrames } = await import(address);
  const { decode } = VideoDecoder.prototype;
  const held = []; // what a decoder was given, and has not looked at
  VideoDecoder.prototype.decode = function (chunk) {
    held.push([this, chunk]);
    if (held.length < 2) return;
    for (const [decoder, one] of held) if (decoder.state === 'configured') decode.call(decoder, one);
  };
  const frames = new VideoFrames();
  const found = [];
  for (const [data, video] of sent) {
    const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
    const pictures = await frames.decode(bytes, video, [64, 64], {});
    if (pictures) {
      const context = new OffscreenCanvas(64, 64).getContext('2d');
      context.drawImage(pictures[0][0], 0, 0);
      found.push(context.getImageData(32, 32, 1, 1).data[0]);
    } else found.push(null);
  }
  VideoDecoder.prototype.decode = decode;
  return found;
}"""


@pytest.fixture
def coded(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What was said of each picture of a video, as it was coded."""
    said: list[dict[str, Any]] = []
    encode = VideoStream.encode

    def spied(self: VideoStream, images: Any, *how: Any) -> Encoded | None:
        encoded = encode(self, images, *how)
        if encoded is not None:
            assert encoded.video is not None
            said.append(encoded.video | {"asked": how[-1] is True})
        return encoded

    monkeypatch.setattr(VideoStream, "encode", spied)
    return said


def matching(page: Any, eyes: int) -> bool:
    """Colours that were put into textures lately are those of the ids that the page says; every other may be alpha."""
    stamps = page.js("watch.uploads.slice(-12)")
    colours = [stamp for stamp in stamps if stamp["id"] is not None]
    assert len(colours) >= len(stamps) // 2 > 0, stamps
    ids = [stamp["id"] for stamp in colours]
    return ids == sorted(ids) and {stamp["eye"] for stamp in colours} == set(range(eyes))


def test_what_is_shown_is_what_was_coded(open_page: OpenPage, serve: Any, coded: list[dict[str, Any]]) -> None:
    served = serve(StoredPairs(), ServerConfig(port=0, video=True), offered=offered)
    page = visit(open_page, served)
    page.until("window.glsplat.stats().shown > 12")
    assert matching(page, 1)
    (client,) = served.server.clients.values()
    before = len(coded)
    client.video.stream._number += 1  # the page misses one: a key frame mends it
    page.meanwhile(lambda: any(one["key"] for one in coded[before:]))
    shown = page.stats()["shown"]
    page.until(f"window.glsplat.stats().shown > {shown + 5}")
    assert matching(page, 1) and sum(one["key"] for one in coded) <= 4
    assert len(coded) >= 10 and coded[0]["key"]
    for before, one in pairwise(coded):  # a key frame begins a video, or was asked for
        assert not one["key"] or one["asked"] or one["size"] != before["size"]
    steer(page, side=256)
    enter(page)
    page.until("watch.uploads.slice(-12).filter(({eye}) => eye === 1).length >= 3")
    assert matching(page, 2)
    assert coded[-1]["size"][0] >= 2 * 256
    assert page.stats()["bitmaps"] <= 4


def test_a_browser_whose_decoder_fails_gets_jpegs(
    open_page: OpenPage, serve: Any, coded: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    files = page_files()
    files["stream/video.js"] += b"VideoDecoder.prototype.decode = () => { throw new Error('no') };"
    monkeypatch.setattr("glsplat.net.pages.page_files", lambda: files)
    page = visit(open_page, serve(StoredPairs(), ServerConfig(port=0, video=True), offered=offered))
    page.until("window.glsplat?.stats().shown > 5", timeout=60)
    assert sum(one["key"] for one in coded) >= 3


def test_a_picture_that_comes_late_is_not_taken_for_the_next(open_page: OpenPage, serve: Any) -> None:
    """A decoder holds back the first picture until it is given the second."""
    served = serve(StoredPairs(), ServerConfig(port=0), offered=offered)
    page = visit(open_page, served)
    sent = []
    for level in (40, 200):
        encoded = VideoStream().encode(np.full((1, 64, 64, 4), level, np.uint8), [next(iter(CODECS))], 90)
        assert encoded is not None
        sent.append([base64.b64encode(encoded.pictures[0]).decode(), encoded.video])
    found = page.js(HELD_BACK, [f"{served.origin}/vr/stream/video.js", sent])
    assert found[0] is None and abs(found[1] - 200) < 8


@pytest.mark.parametrize("codec", CODECS)
def test_colours_and_alpha_are_those_of_the_picture(open_page: OpenPage, serve: Any, codec: str) -> None:
    """A chart of smooth colours, twice as far from each other as it can go, and a ramp of alpha."""
    served = serve(StoredPairs(), ServerConfig(port=0), offered=offered)
    page = visit(open_page, served)
    side = 64
    ramp = np.linspace(0, 255, side)
    images = np.zeros((2, side, side, 4), np.uint8)
    for eye in (0, 1):
        images[eye, ..., eye] = ramp[None, :]
        images[eye, ..., 2 - eye] = ramp[:, None]
        images[eye, ..., 3] = ramp[None, ::-1]
    encoded = VideoStream().encode(images, [codec], 90, alpha=True)
    assert encoded is not None
    data = base64.b64encode(encoded.pictures[0]).decode()
    found = page.js(DECODE, [f"{served.origin}/vr/stream/video.js", data, encoded.video, [side, side]])
    for eye, (colour, alpha) in enumerate(found):
        rgb, grey = (np.array(one).reshape(side, side, 4)[..., :3].astype(float) for one in (colour, alpha))
        assert np.abs(rgb - images[eye, ..., :3]).mean() < 2.5
        assert np.abs(grey[..., 0] - images[eye, ..., 3]).mean() < 1.5
