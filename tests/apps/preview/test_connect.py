"""The preview on a running server: a viewer on a framebuffer, then the command under Xvfb."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from apps.output import side_by_side
from apps.preview.cameras import Options
from apps.preview.connect import StreamedPictures, read_tracked
from apps.preview.feed import Feed, ViewRequest
from apps.preview.viewer import Viewer
from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.extras.rooms.feature import Rooms
from glsplat.extras.rooms.person import Person
from glsplat.formats import save
from glsplat.gl.context import Context
from glsplat.net.backend import AvatarInfo, Rendered
from glsplat.net.guard.access import Access
from glsplat.net.messages import WireOptions
from glsplat.net.served_scene import gl_server, server_of
from glsplat.net.server import Server, ServerConfig
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from tests.browser.served import Served
from tests.scenes import camera, cloud, limb
from tests.xvfb import display, psnr, python  # noqa: F401  (a fixture)

VIEW = Options(eye=(0.4, 0.3, 3.0), target=(0.7, 0.0, 0.0))


class Grey:
    """A renderer without OpenGL: all pixels have the grey value of the camera's x in centimetres."""

    def __init__(self) -> None:
        self.requests: list = []

    def open(self) -> str:
        return "numpy"

    def render(self, request) -> Rendered:
        self.requests.append(request)
        c = request.cameras[0]
        shade = round(100 * float(c.position[0]))
        return Rendered(np.full((len(request.cameras), c.height, c.width, 4), shade, np.uint8), {"draw": 1.0})

    def close(self) -> None: ...


@contextmanager
def serving(make: Callable[[], Server]) -> Iterator[str]:
    """The address of a server in a thread of its own."""
    with Served(make=lambda config: make()) as served:
        assert served.server is not None
        yield served.server.url


@contextmanager
def feeding(url: str, **options) -> Iterator[Feed]:
    feed = Feed(url, **options)
    feed.start()
    try:
        yield feed
    finally:
        feed.close()


def at(x: float, size: int = 32) -> ViewRequest:
    view = camera(size)
    viewmat = view.viewmat.copy()
    viewmat[0, 3] = -x
    return ViewRequest([replace(view, viewmat=viewmat)])


def until(condition: Callable[[], object], seconds: float = 60.0) -> bool:
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return bool(condition())


def shade(feed: Feed) -> float:
    picture = feed.take()
    assert picture is not None
    return float(np.median(picture.images[..., :3]))


def test_the_newest_wish_is_answered_and_a_quiet_feed_asks_for_nothing() -> None:
    backend, woken, token = Grey(), [], "0123456789abcdef"
    options = ServerConfig(port=0, wire=WireOptions(size=(32, 32), max_side=40), access=Access(token=token))
    with serving(lambda: server_of(backend, options)) as url:
        with pytest.raises(GlsplatError, match="needs a token"):
            Feed(url).start()
        with feeding(url, quality=100, token=token) as feed:
            feed.wake = lambda: woken.append(1)
            for x in (0.5, 0.7, 0.9, 1.1):
                feed.request(at(x))
            feed.wait_ready()
            assert shade(feed) == pytest.approx(110, abs=1) and until(lambda: woken)
            assert len(backend.requests) <= 4 and feed.take() is None and feed.notice == ""
            count = len(backend.requests)
            feed.request(at(1.3))
            feed.wait_ready()
            assert shade(feed) == pytest.approx(130, abs=1) and len(backend.requests) == count + 1
            feed.request(at(0.5, 150))  # too large for the server: it is drawn smaller
            feed.wait_ready()
            picture = feed.take()
            assert picture is not None and picture.images.shape == (1, 38, 38, 4) and feed.notice == ""


def test_in_a_room_it_comes_back_as_the_same_person() -> None:
    rig = Skeleton.from_joints(["root", "head"], [-1, 0], [[0, 0, 0], [0, 1, 0]])
    made: list[Server] = []

    def make() -> Server:
        offered = (AvatarInfo(name="default", skeleton=rig),)
        made.append(server_of(Grey(), ServerConfig(port=0, rooms={"lab": 2}), offered))
        return made[0]

    def person() -> Person:
        return made[0].feature(Rooms)._rooms["lab"]._guests["Ann"].person

    with serving(make) as url, feeding(f"{url}?room=lab&name=Ann") as feed:
        feed.request(at(0.5))
        feed.wait_ready()
        first = person()
        connection = feed._client._connection
        assert connection is not None
        feed._loop.call_soon_threadsafe(connection._ws._writer.transport.abort)  # type: ignore[union-attr]
        assert until(lambda: feed.reconnects == 1)
        assert person() is not first and person().resume == first.resume and person().seat is first.seat


@pytest.fixture(scope="module")
def limb_server() -> Iterator[str]:
    with serving(lambda: gl_server(limb(degree=1), ServerConfig(port=0))) as url:
        yield url


@pytest.fixture
def watching(context: Context, limb_server: str) -> Iterator[Callable[..., Viewer]]:
    made: list[tuple[Viewer, Feed]] = []

    def make(scene: Avatar, size: tuple[int, int], options: Options = VIEW, url: str = limb_server) -> Viewer:
        feed = Feed(url, quality=95)
        feed.start()
        made.append((Viewer(scene, context, size, options, "server", StreamedPictures(feed, context.ctx)), feed))
        return made[-1][0]

    with context.ctx:
        yield make
        for viewer, feed in made:
            viewer.release()
            feed.close()
        assert context.ctx.error == "GL_NO_ERROR"


def headless(context: Context, scene: Avatar, cameras: list[Camera], pose: Pose | None) -> np.ndarray:
    with Renderer(scene, size=(cameras[0].width, cameras[0].height), context=context) as renderer:
        return renderer.render(cameras, pose)[..., :3]


@pytest.mark.gl
def test_the_viewer_shows_what_the_server_draws(
    watching: Callable[..., Viewer], context: Context, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    avatar = limb(degree=1)
    viewer = watching(avatar, (193, 128), replace(VIEW, ipd=0.3))
    assert viewer.player is not None
    viewer.player.select(1)
    viewer.player.turn((0, 0, 1), 40)
    viewer.press("2")
    viewer.wait_ready()
    shown = viewer.capture()
    expected, rest = (headless(context, avatar, viewer.cameras(), pose) for pose in (viewer.pose(), None))
    assert psnr(shown[:, :192], side_by_side(expected)) > 32  # JPEG, colours at half resolution
    assert psnr(shown[:, :192], side_by_side(rest)) < 25 and not shown[:, 192:].any()
    viewer.press("1")
    viewer.wait_ready()
    viewer.capture()
    viewer.resize(97, 65)  # the old picture is scaled until the new one comes
    scaled = viewer.capture()
    viewer.wait_ready()
    exact, expected = viewer.capture(), side_by_side(headless(context, avatar, viewer.cameras(), viewer.pose()))
    assert scaled.shape == exact.shape == (65, 97, 3)
    assert psnr(exact, expected) > 30 and 15 < psnr(scaled, expected) < psnr(exact, expected)
    save(cloud(), tmp_path / "cloud.ply")
    viewer.drop(str(tmp_path / "cloud.ply"))
    assert "the server chooses" in capsys.readouterr().err and viewer.player is not None


@pytest.mark.gl
def test_the_window_is_redrawn_for_new_pictures_only(
    watching: Callable[..., Viewer], context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = watching(limb(degree=1), (96, 64), replace(VIEW, numbers=True))
    texture = context.ctx.texture((96, 64), 4)
    screen = context.ctx.framebuffer([texture])
    try:
        viewer.wait_ready()
        assert viewer.refresh(screen) and not viewer.dirty
        assert not viewer.refresh(screen)  # the same view: neither asked for nor drawn
        viewer.drag("left")
        viewer.move(20, 10)
        asked: list[tuple[Feed, object]] = []
        with monkeypatch.context() as held:  # what is asked for goes no further, or its picture might be here at once
            held.setattr(Feed, "request", lambda *wish: asked.append(wish))
            assert not viewer.refresh(screen) and not viewer.dirty  # the old picture stays until the new one comes
        Feed.request(*asked.pop())
        assert not asked
        assert until(lambda: (viewer.advance(0.0), viewer.dirty)[1])
        assert viewer.refresh(screen) and not viewer.refresh(screen)
        viewer.expose()
        assert viewer.refresh(screen)
        lines, stages = [line[0] for line in viewer._text], "wait render encode communication decode present".split()
        assert [line for line in lines if line in stages] == stages
        assert any("kB" in line and "after it was asked for" in line for line in lines)
        report = viewer.report()
        assert report["shown"] == 2 and report["reconnects"] == 0 and report["timings_ms"]["render"] > 0
    finally:
        context.scratch.use()
        screen.release()
        texture.release()


@pytest.mark.gl
def test_a_recording_goes_as_tracking(context: Context) -> None:
    motion, backend = read_tracked(None), Grey()
    assert len(motion) > 72 and all("head" in sample for sample in motion.samples)
    with serving(lambda: server_of(backend, ServerConfig(port=0))) as url, feeding(url) as feed, context.ctx:
        viewer = Viewer(default_avatar(), context, (32, 32), VIEW, "server", StreamedPictures(feed, context.ctx))
        try:
            assert viewer.player is not None
            viewer.player.play(motion)
            with pytest.raises(GlsplatError, match="no tracking solver"):  # this server has none
                viewer.wait_ready()
            assert "no tracking solver" in feed.notice
            viewer.press("left")
            assert "no joint can be turned" in viewer.overlay.lines(list)[-1][0]
            viewer.player.hold(None)
            drawn = len(backend.requests)
            viewer.wait_ready()
            assert feed.notice == "" and len(backend.requests) > drawn
        finally:
            viewer.release()
