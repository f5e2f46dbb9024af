"""``glsplat preview --xr``: the command on a fake headset, on a server's pictures, and where there is no runtime."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from apps.args import open_scene
from apps.preview import command, headset
from apps.preview.feed import Feed
from apps.preview.headset_feed import FeedShow
from glsplat.errors import ContextError
from glsplat.extras.openxr import placing
from glsplat.extras.openxr.openxr.runtime import OpenXrRuntime
from glsplat.extras.openxr.placing import camera_of
from glsplat.extras.openxr.session import Session
from glsplat.extras.openxr.wearer import Wearer
from glsplat.gl.context import Context, create_context
from glsplat.net.backend import AvatarInfo, Rendered
from glsplat.net.messages import WireOptions
from glsplat.net.served_scene import server_of
from glsplat.net.server import Server, ServerConfig
from glsplat.tracking.recording import replay
from tests.apps.cli import mistake, parsed
from tests.apps.preview.test_connect import feeding, serving
from tests.extras.openxr.fake import HEAD, FakeRuntime

pytestmark = pytest.mark.gl


def test_the_views_of_the_option_are_those_of_the_extra() -> None:
    assert command.VIEWS == placing.VIEWS


def worn(*words: str, frames: int = 4, **made: Any) -> FakeRuntime:
    """The command on a fake headset; the runtime afterwards."""
    found: list[FakeRuntime] = []

    def connect(context: Context, passthrough: bool) -> FakeRuntime:
        found.append(FakeRuntime(context, size=(64, 48), **made))
        return found[-1]

    args = parsed(command, "--xr", *words)
    command.check_headset(args)
    assert headset.run(args, open_scene(args), frames, connect) == 0  # type: ignore[arg-type]
    return found[-1]


def test_frames_a_report_a_picture_and_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture, samples = tmp_path / "seen.png", tmp_path / "worn.jsonl"
    runtime = worn("--view", "facing", "--json", "--screenshot", str(picture), "--record", str(samples))
    said = capsys.readouterr()
    report = json.loads(said.out)
    assert report["rendered"] == 4 and report["runtime"] == runtime.name and report["view"] == "facing"
    assert report["overhead_ms"] > 0 and {"draw", "copy"} <= set(report["timings_ms"])
    image = cv2.imread(str(picture))
    assert image.shape == (48, 128, 3) and image.max() > 100
    recorded = list(replay(samples))
    assert len(recorded) == 4 and recorded[0].head == pytest.approx(HEAD, abs=1e-6) and "4 samples" in said.err
    assert runtime.log.count("request_exit") == 1 and runtime.log[-1] == "end"  # let go of, not dropped
    assert all(chain.closed for chain in runtime.swapchains) and runtime.closed


def test_what_can_be_asked_for() -> None:
    runtime = worn("--scale", "0.5", "--height", "1.8", "--no-floor", "--level", "2", "--solver", "analytic")
    assert runtime.swapchains[0].size == (32, 24) and runtime.shown[-1][1] == "opaque"
    seen = worn("--passthrough", blends=("additive", "alpha"))
    assert seen.shown[-1][1] == "alpha" and seen.shown[-1][0].transparent  # type: ignore[union-attr]
    assert worn(blends=("additive",)).shown[-1][1] == "additive"  # glasses that have nothing else
    with pytest.raises(ContextError, match="shows no room around the wearer"):
        worn("--passthrough")


# ------------------------------------------------------------------------------------------- nothing there: one line


class NoRuntime(ModuleType):
    """pyopenxr where nothing answers: what is asked for fails as it does there."""

    def __init__(self, **fails: str) -> None:
        super().__init__("xr")
        self.fails, self.names = fails, ("XR_KHR_opengl_enable", "XR_MNDX_egl_enable")
        base = type("ResultException", (Exception,), {})
        self.exception = SimpleNamespace(XrException=base, ResultException=base, QualifiedSuccessResult=())
        self.kinds: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if name.endswith("Error") or name == "SessionLossPending":
            return self.kinds.setdefault(name, type(name, (self.exception.XrException,), {}))

        def call(*_: object, **__: object) -> Any:
            if name in self.fails:
                raise getattr(self, self.fails[name])(self.fails[name])
            if name == "enumerate_instance_extension_properties":
                return [SimpleNamespace(extension_name=known.encode()) for known in self.names]
            return SimpleNamespace(runtime_name=b"a runtime", HEAD_MOUNTED_DISPLAY=1)

        call.HEAD_MOUNTED_DISPLAY = 1  # type: ignore[attr-defined]  # FormFactor
        return call


def test_one_line_where_there_is_nothing(
    context: Context, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    vulkan = NoRuntime()
    vulkan.names = ("XR_KHR_vulkan_enable2",)
    for module, said in (
        (None, "needs pyopenxr"),  # not installed
        (NoRuntime(enumerate_instance_extension_properties="RuntimeUnavailableError"), "no OpenXR runtime is active"),
        (NoRuntime(create_instance="RuntimeFailureError"), "start SteamVR"),
        (NoRuntime(get_system="FormFactorUnavailableError"), "a runtime sees no headset: connect it"),
        (NoRuntime(get_system="SystemInvalidError"), "a runtime has no system"),
    ):
        monkeypatch.setitem(sys.modules, "xr", module)
        assert said in mistake(capsys, "preview", "--xr", "--frames", "1")
    monkeypatch.setitem(sys.modules, "xr", vulkan)
    with pytest.raises(ContextError, match="takes no pictures of OpenGL"):
        OpenXrRuntime(context)


# ----------------------------------------------------------------------------------------------- a server's pictures


class Seen:
    """Draws nothing, but remembers what it was asked for; the number of the request is in the picture's grey."""

    def __init__(self) -> None:
        self.requests: list[Any] = []

    def open(self) -> str:
        return "numpy"

    def render(self, request: Any) -> Rendered:
        self.requests.append(request)
        camera = request.cameras[0]
        out = np.full((2, camera.height, camera.width, 4), 128, np.uint8)
        if request.options.alpha:
            out[:, : camera.height // 2] = 0  # nobody above
        return Rendered(out, {"draw": 1.0})

    def close(self) -> None: ...


class Pane:
    """A window without a window system; the user closes it after some pictures."""

    def __init__(self, context: Context, size: tuple[int, int], pictures: int) -> None:
        self._context, self.size, self._left, self.swaps = context.ctx, size, pictures, 0
        self.framebuffer = context.ctx.framebuffer([context.ctx.texture(size, 4)])

    @property
    def closing(self) -> bool:
        return self.swaps >= self._left

    def wait(self, seconds: float) -> None: ...

    def swap(self) -> None:
        self.swaps += 1


def test_a_window_shows_each_picture_once_and_closing_it_ends_the_session(context: Context) -> None:
    from glsplat.data import default_avatar
    from glsplat.extras.openxr.local import LocalShow

    runtime, pane = FakeRuntime(context, size=(64, 48)), Pane(context, (80, 48), 3)
    show = LocalShow(default_avatar(), context, Wearer("facing"))
    session = Session(lambda: runtime, show)  # type: ignore[arg-type, return-value]
    headset.loop(session, show, pane, None)  # type: ignore[arg-type]
    assert pane.swaps == 4 == session.rendered  # it was closed when a fourth had been drawn
    assert runtime.log[-1] == "end"
    seen = np.frombuffer(pane.framebuffer.read(components=3), np.uint8).reshape(48, 80, 3)
    assert np.array_equal(seen[::-1, 8:72], runtime.swapchains[0].read()[0, ..., :3]) and seen.max() > 60
    session.close()
    show.release()
    pane.framebuffer.color_attachments[0].release()
    pane.framebuffer.release()


@pytest.fixture
def context() -> Iterator[Context]:
    made = create_context()
    with made:
        yield made
    made.release()


def until(session: Session, done: Callable[[], bool]) -> None:
    limit = time.monotonic() + 60
    while not done():
        assert session.step() and time.monotonic() < limit
        time.sleep(0.005)


def tracking(backend: Seen) -> Server:
    from glsplat.data import default_avatar
    from glsplat.net.backends.tracking import TrackingSolver
    from glsplat.tracking.calibration import Calibration

    skeleton = default_avatar().skeleton

    def solver(height: float | None, span: float | None) -> TrackingSolver:
        return TrackingSolver(skeleton, Calibration(), "analytic")

    parts = frozenset({"head"})
    info = AvatarInfo(name="default", skeleton=skeleton, solver=solver, parts=parts)
    return server_of(backend, ServerConfig(port=0, wire=WireOptions(max_side=64)), [info])  # type: ignore[arg-type]


def test_pictures_are_shown_for_the_eyes_that_they_were_asked_for(context: Context) -> None:
    backend, said = Seen(), []
    runtime = FakeRuntime(context, size=(64, 48))
    with serving(lambda: tracking(backend)) as url, feeding(url, quality=100) as feed:
        show = FeedShow(feed, context, Wearer("mirror"), floor=False, say=said.append)
        session = Session(lambda: runtime, show)  # type: ignore[arg-type, return-value]
        until(session, lambda: show.pictures >= 2)
        projection = runtime.shown[-1][0]
        assert projection is not None and not projection.depth
        request = backend.requests[-1]
        assert request.options.hide == () and np.linalg.det(request.cameras[0].viewmat[:3, :3]) < 0  # reflected there
        pair = runtime.swapchains[0].read()
        inside = np.all(np.abs(pair[..., :3].astype(int) - 128) <= 2, axis=-1)
        assert 0.1 < inside.mean() < 0.9 and np.all(pair[..., :3][pair[..., 3] == 0] == 0)  # in the mirror alone

        # the head moves; what is shown next was asked for before that, and says so
        asked = {view.pose for view in projection.views}
        runtime.eyes = tuple((0.5 + x, 1.5, 0.0, 0.0, 0.3826834, 0.0, 0.9238795) for x in (-0.03, 0.03))
        count = show.pictures

        def there() -> bool:
            return any(p is not None and {v.pose for v in p.views} == set(runtime.eyes or ()) for p, _ in runtime.shown)

        until(session, there)
        poses = [tuple(v.pose for v in p.views) for p, _ in runtime.shown if p is not None]
        assert set(poses[-1]) == set(runtime.eyes) and asked == set(poses[count]) and show.age_ms > 0

        # the camera that drew a picture is that of the eyes it is shown for
        last = runtime.shown[-1][0]
        assert last is not None
        place = show._last and next(p for p in [show.wearer._place])
        assert place is not None
        wanted = camera_of(last.views[0], (64, 48), place.shown)
        drawn = [c for r in backend.requests for c in r.cameras]
        assert any(np.allclose(wanted.viewmat, c.viewmat, atol=1e-4) for c in drawn)
        session.close()
        show.release()
    assert not said


def test_pictures_smaller_than_asked_for_and_a_server_that_goes(
    context: Context, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the own body, which comes without a head and with alpha; and the whole command."""
    backend, said = Seen(), []
    runtime = FakeRuntime(context, size=(150, 100))  # more than the server's 64
    with serving(lambda: tracking(backend)) as url:
        worn("--url", url, "--json", "--quality", "90")
        report = json.loads(capsys.readouterr().out)
        assert report["pictures"] >= 1 and report["age_ms"] > 0 and backend.requests
        feed = Feed(url, quality=100)
        feed.start()
        show = FeedShow(feed, context, Wearer("own"), transparent=True, say=said.append)
        session = Session(lambda: runtime, show)  # type: ignore[arg-type, return-value]
        until(session, lambda: show.pictures >= 1)
        assert runtime.swapchains[-1].size == (38, 25)
        assert backend.requests[-1].options.hide == ("head",) and backend.requests[-1].options.alpha
        projection, pair = runtime.shown[-1][0], runtime.swapchains[-1].read()
        assert projection is not None and projection.transparent
        assert pair[:, :10].max() <= 3 and abs(int(pair[:, 15:, :, 3].min()) - 128) <= 3  # premultiplied
    try:
        until(session, lambda: bool(said))
        assert "trying again" in said[0]
        before = runtime.shown[-1][0]
        for _ in range(3):
            assert session.step()
        assert runtime.shown[-1][0] is before and before is not None  # the last picture stays where it was
    finally:
        session.close()
        show.release()
        feed.close()
