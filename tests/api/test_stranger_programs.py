"""What strangers do to renderers, tracking and clients: it works, or one line says what was expected."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat import Camera, Item, RenderConfig, Renderer
from glsplat.detail.selector import Selector
from glsplat.errors import ContextError
from glsplat.net.client import Client
from glsplat.renderer import RendererThread
from glsplat.tracking import Calibration, Sample, Tracker, TrackerConfig
from tests.api.test_stranger import NO_NUMBERS, NO_SIZES, VIEW, refused
from tests.scenes import cloud

# ---------------------------------------------------------------------------------------------------------- renderers


@pytest.mark.gl
@pytest.mark.parametrize("given", [5, "egl", [], glsplat])
def test_what_is_no_context_is_refused(given: Any) -> None:
    refused(lambda: glsplat.create_context(given=given), "given needs a Context")
    refused(lambda: glsplat.create_context(device=1.5), "device")  # type: ignore[arg-type]
    refused(lambda: glsplat.create_context(device=True), "device")
    refused(lambda: glsplat.create_context(backend=5), "backend")  # type: ignore[arg-type]


@pytest.mark.gl
@pytest.mark.parametrize("size", NO_SIZES)
def test_a_renderers_size_is_two_whole_numbers(size: Any) -> None:
    refused(lambda: Renderer(cloud(5), size=size), "size")
    refused(lambda: Renderer.run_in_thread(cloud(5), size=size), "size")
    if isinstance(size, tuple) and len(size) == 2:
        with Renderer(cloud(5), size=(8, 8)) as renderer:
            refused(lambda: renderer.resize(*size), "size")
            assert renderer.size == (8, 8)


@pytest.mark.gl
def test_sizes_of_numpy_are_sizes() -> None:
    for size in (np.array([8, 9]), [8, 9], (np.int32(8), np.uint8(9))):
        with Renderer(cloud(5), size=size, views=np.int64(1)) as renderer:  # type: ignore[arg-type]
            assert renderer.size == (8, 9) and all(type(side) is int for side in renderer.size)


@pytest.mark.gl
def test_every_call_belongs_to_the_renderers_thread() -> None:
    with Renderer(cloud(5), size=(8, 8)) as renderer:
        said: list[Any] = []
        calls = [lambda: renderer.resize(9, 9), renderer.nbytes, renderer.drop_targets, lambda: renderer.load(cloud(6))]

        def run() -> None:
            for call in calls:
                try:
                    said.append(call())
                except ContextError as error:
                    said.append(str(error))

        thread = threading.Thread(target=run, name="another")
        thread.start()
        thread.join()
        assert len(said) == len(calls) and all("another" in str(one) for one in said), said
        assert renderer.size == (8, 8)
    for call in calls:
        refused(call, "released")


@pytest.mark.gl
def test_a_renderer_thread_renders_all_that_a_renderer_does() -> None:
    camera = Camera(VIEW, glsplat.pinhole(8, 8), 8, 8)
    item = Item(cloud(50))
    options: dict[str, Any] = {"size": (8, 8), "config": RenderConfig(output="float32")}
    with Renderer(item, **options) as renderer, Renderer.run_in_thread(item, **options) as thread:
        for more in ({}, {"depth": True}):
            one, other = renderer.render([camera], **more), thread.render([camera], **more)
            assert all(map(np.array_equal, one, other))
        out = np.empty((1, 8, 8, 4), np.float32)
        assert thread.render([camera], out=out) is out and out.any()
        assert (
            isinstance(thread, Renderer)
            and thread.stats.drawn == renderer.stats.drawn
            and thread.nbytes() == renderer.nbytes()
        )
        assert thread.driver == renderer.driver and thread.config == options["config"]
        thread.selector = mine = Selector(1.0)
        assert thread.submit(lambda renderer: renderer.selector).result() is mine is thread.selector
        thread.resize(4, 4)
        assert thread.size == (4, 4) and thread.prepare([camera.resized(4, 4)]).cost > 0
        with pytest.raises(AttributeError):
            thread.nothing  # noqa: B018


def test_a_renderer_thread_has_every_name_of_a_renderer() -> None:
    public = {name for name in vars(Renderer) if not name.startswith("_")}
    assert len(public) > 10
    for name in public - {"run_in_thread"}:
        assert getattr(Renderer, name) is not getattr(RendererThread, name)
        assert getattr(Renderer, name).__doc__ and "_method" not in repr(getattr(RendererThread, name).__doc__)


# ------------------------------------------------------------------------------------------------ tracking and clients

HAND = tuple((0.01 * i, 1.0, -0.3) for i in range(25))
NO_HANDS: list[Any] = [HAND[:24], (), 5, "joints", (1,) * 25]
AT = (0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    "given",
    [
        *(
            {"left": hand, "left_joints": joints}
            for hand in (AT, None)
            for joints in (HAND[:24], (), 5, "joints", (1,) * 25)
        ),
        {"right": AT, "right_joints": tuple(joint[:2] for joint in HAND)},
        {"right_joints": (*HAND, HAND[0])},
        *({"body": body} for body in (5, "body", [1], True, {"hips": 5}, {"hips": (1.0,)})),
        {"head": (1, 2)},
        {"waist": "waist"},
    ],
)
def test_a_sample_of_something_else_is_flagged(given: dict[str, Any]) -> None:
    tracker = Tracker(glsplat.default_avatar().skeleton, solver="analytic")
    for step in range(3):
        pose = tracker.update(Sample(**{"t": 0.1 * step, "head": AT, **given}))
        assert tracker.flags.count("invalid") == 1, tracker.flags
        assert np.isfinite(pose.rotations).all()
    tracker.update(Sample(0.5, AT, AT, left_joints=HAND, body={"hips": (0.0, 0.9, 0.0)}))
    assert "invalid" not in tracker.flags


def test_a_tracker_is_made_of_a_skeleton() -> None:
    avatar = glsplat.default_avatar()
    refused(lambda: Tracker(avatar), "Skeleton, not Avatar", ".skeleton")  # type: ignore[arg-type]
    for thing in (5, None, "person", avatar.splats):
        refused(lambda thing=thing: Tracker(thing), "Skeleton")
    refused(lambda: Tracker(avatar.skeleton, {"scale": 1}), "Calibration")  # type: ignore[arg-type]
    refused(lambda: Tracker(avatar.skeleton, None, {"gap": 1}), "TrackerConfig")  # type: ignore[arg-type]
    assert Tracker(avatar.skeleton, Calibration(), TrackerConfig())


@pytest.mark.parametrize("token", ["a\n", "a\r\nX-Admin: 1", "a b", "\u00e4", "\0", 5, b"token", ["a"]])
def test_a_token_is_a_word(token: Any) -> None:
    refused(lambda: Client("ws://localhost:1/ws", token), "token")


@pytest.mark.parametrize("timeout", [0, -1, -0.5, np.nan, np.inf, *NO_NUMBERS])
def test_a_timeout_is_seconds(timeout: Any) -> None:
    refused(lambda: Client("ws://localhost:1/ws", timeout=timeout), "timeout needs")


@pytest.mark.parametrize(
    "given",
    [{"window": 0}, {"window": 1.5}, {"window": "2"}, {"height": "tall"}, {"span": np.nan}, {"at": 5}, {"at": (1, 2)}]
    + [
        {"at": "123"},
        {"at": (1, 2, "3")},
        {"url": 5},
        {"url": None},
        {"url": b"ws://localhost:1/ws"},
        {"url": "localhost"},
    ],
)
def test_a_clients_options_are_what_they_say(given: dict[str, Any]) -> None:
    refused(lambda: Client(**{"url": "ws://localhost:1/ws", **given}))


def test_a_silent_server_is_not_one_that_is_not_there() -> None:
    async def said() -> tuple[tuple[str, str], tuple[str, str]]:
        async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.read()
            writer.close()

        server = await asyncio.start_server(silent, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        found = []
        for url in (f"ws://127.0.0.1:{port}/ws", "ws://127.0.0.1:1/ws"):
            with pytest.raises(glsplat.errors.ProtocolError) as caught:
                await Client(url, timeout=0.3).connect()
            found.append((str(caught.value), caught.value.code))
        server.close()
        return found[0], found[1]

    (there, code), (gone, other) = asyncio.run(said())
    assert "no answer within 0.3 s" in there and "start one" not in there and code == "timeout"
    assert "start one with `glsplat serve`" in gone and other == "unreachable"
