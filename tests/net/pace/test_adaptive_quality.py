"""Adaptive quality against a simulated machine, and in a server's replies."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.client import Client
from glsplat.net.pace.adaptive_quality import BIAS, FULL, SCALES, AdaptiveQuality, Detail
from glsplat.net.pace.ladder import ladder
from glsplat.net.reply import Reply
from glsplat.net.server import ServerConfig
from tests.net.clocks import Stopped
from tests.net.conftest import FakeBackend, Serve, eyes

Cost = Callable[[Detail, float], float]
History = list[tuple[float, int, Detail]]


def level_of(detail: Detail) -> int:
    return int(min(-detail.bias // 1, 3))


def machine(full: float, noise: float = 0.03, seed: int = 0) -> Cost:
    """Seconds of a picture: half a level, half the splats; the size counts for a third."""
    rng = np.random.default_rng(seed)

    def cost(detail: Detail, now: float) -> float:
        splats = 0.5 ** level_of(detail)
        return full * splats * (2 / 3 + detail.scale**2 / 3) * float(rng.normal(1, noise))

    return cost


def run(adaptive_quality: AdaptiveQuality, costs: dict[int, Cost], seconds: float, start: float = 0.0) -> History:
    """Draw for all viewers in turn, at most 72 times a second; each entry is (time, viewer, detail)."""
    now = start
    history: History = []
    while now < start + seconds:
        before = now
        for viewer, cost in costs.items():
            detail = adaptive_quality.detail(viewer, now)
            took = cost(detail, now)
            now += took
            adaptive_quality.drawn(viewer, took, level_of(detail) == 3, now)
            history.append((now, viewer, detail))
        now = max(now, before + 1 / 72)
    return history


@pytest.mark.parametrize(
    ("full", "bias", "scale"), [(0.015, 0, 1), (0.04, -1, 1), (0.08, -2, 1), (0.2, -3, 0.75), (5.0, -3, 0.5)]
)
def test_levels_go_first_then_the_size(full: float, bias: float, scale: float) -> None:
    history = run(AdaptiveQuality(45), {1: machine(full, noise=0.01)}, 90)
    last = history[-1][2]
    assert (level_of(last), last.scale) == (-bias, scale)
    if full < 5:
        assert len([now for now, _, _ in history if now > 60]) / 30 >= 40  # pictures a second
    assert all(detail.scale == 1 or level_of(detail) == 3 for _, _, detail in history)
    assert bias or {detail for _, _, detail in history} == {FULL}


@pytest.mark.check
def test_it_does_not_swing() -> None:
    """A level that takes 0.97 of the time while the finer one takes too long is retried ever less often."""
    history = run(AdaptiveQuality(45), {1: machine(0.043, noise=0.01)}, 300)
    changed = [now for (_, _, one), (now, _, other) in pairwise(history) if one != other]
    assert sum(now < 100 for now in changed) >= 2 and sum(now > 200 for now in changed) <= 4


def test_viewers_share_the_time() -> None:
    adaptive_quality = AdaptiveQuality(30)
    alone = run(adaptive_quality, {1: machine(0.02)}, 10)
    assert alone[-1][2] == FULL
    two = run(adaptive_quality, {1: machine(0.02), 2: machine(0.02, seed=1)}, 20, start=alone[-1][0])
    assert all(detail != FULL for _, _, detail in two[-2:])
    again = run(adaptive_quality, {1: machine(0.02)}, 50, start=two[-1][0])
    assert again[-1][2] == FULL and len(adaptive_quality._states) == 2
    run(adaptive_quality, {1: machine(0.02)}, 70, start=again[-1][0])
    assert len(adaptive_quality._states) == 1  # who has left is forgotten


def test_eyes_with_less_detail() -> None:
    view = Camera(look_at((0, 0, 2), (0, 0, 0)), pinhole(640, 480), 640, 480)
    less = Detail(-1.5, 0.75).resized((view, view))
    assert (less[0].width, less[1].height) == (480, 360)
    assert np.allclose(less[0].K[0, 0], 0.75 * view.K[0, 0])
    assert FULL.resized((view, view)) == (view, view)
    tiny = Camera(view.viewmat, pinhole(1, 1), 1, 1)
    assert Detail(0, SCALES[-1]).resized([tiny])[0].width == 1


@pytest.mark.parametrize("others", [1, 16])
def test_those_who_hardly_ask_take_nothing_from_the_others(others: int) -> None:
    """Many connections that each ask for a tiny picture a second."""
    adaptive_quality, cost, now, details = AdaptiveQuality(45), machine(0.015), 0.0, []
    asked = [0.9 * number / others for number in range(others)]
    while now < 20:
        before, detail = now, adaptive_quality.detail(1, now)
        took = cost(detail, now)
        now += took
        adaptive_quality.drawn(1, took, level_of(detail) == 3, now)
        details.append(detail)
        for number, due in enumerate(asked):
            if now >= due:
                adaptive_quality.detail(2 + number, now)
                now += 0.001
                adaptive_quality.drawn(2 + number, 0.001, True, now)
                asked[number] = now + 0.9
        now = max(now, before + 1 / 72)
    assert {*details} == {FULL}
    assert all(len(state.spent) < 80 for state in adaptive_quality._states.values())  # of the last second


def test_three_slow_pictures_do_not_take_everything() -> None:
    adaptive_quality, now = AdaptiveQuality(45), 0.0
    for seconds in [0.005] * 20 + [0.7] * 3 + [0.005] * 5:
        adaptive_quality.detail(1, now)
        now += seconds
        adaptive_quality.drawn(1, seconds, False, now)
    assert adaptive_quality.detail(1, now).bias >= -1
    history = run(adaptive_quality, {1: machine(0.005)}, 10, start=now)
    assert history[-1][2] == FULL


def test_a_picture_beyond_its_budget_gets_less_at_once() -> None:
    adaptive_quality = AdaptiveQuality(10)
    adaptive_quality.detail(1, 0.0)
    for _ in range(4):
        adaptive_quality.refused(1, 0.1)
    assert adaptive_quality.detail(1, 0.2).bias <= -4 * BIAS
    adaptive_quality.refused(7, 0.1)  # who has never asked


def test_a_size_comes_back_that_took_little_when_it_was_last_so() -> None:
    """By pixels alone the next size would take too long."""
    adaptive_quality, drawn = AdaptiveQuality(40), []
    for picture in range(200):
        now = picture / 40
        drawn.append(adaptive_quality.detail(1, now).scale)
        adaptive_quality.drawn(1, (0.8 if drawn[-1] == 1 else 0.7) / 40, True, now)
        if picture == 20:
            adaptive_quality.refused(1, now)
    assert drawn[20:22] == [1.0, SCALES[1]] and drawn[-1] == 1.0


def test_one_decision_of_the_smaller_size() -> None:
    rungs = ladder(80, False)
    small = next(rung for rung in rungs if rung.scale == 0.75)
    assert FULL.within(rungs[0]) is FULL
    assert Detail(-0.5, 0.5).within(small) == Detail(-0.5, 0.5, small)
    assert Detail(-0.5, 1.0).within(small) == Detail(-0.5, 0.75, small)
    said = FULL.within(small).fields((0,))
    assert said["scale"] == 0.75 and said["quality"] == small.quality and said["why"] == "link"
    assert "why" not in Detail(-0.5, 0.5).fields((0,))


def test_what_the_link_made_small_gives_no_time_back() -> None:
    held = {}
    for smaller in (False, True):
        quality, now = AdaptiveQuality(20), 0.0
        for index in range(400):
            now += 0.05
            quality.detail(1, now)
            quality.drawn(1, 0.2 if index < 40 else 0.005, False, now, smaller)
        held[smaller] = quality.detail(1, now).bias
    assert held[True] < held[False]


@dataclass
class Levels(FakeBackend):
    """Two levels: the finer one takes ``slow`` seconds, the other a tenth; half the pixels a tenth of that."""

    clock: Stopped = field(default_factory=Stopped)
    slow: float = 0.05
    last: int = 1

    def render(self, request: RenderJob) -> Rendered:
        level = min(int(request.detail <= -1), self.last)
        self.clock.now += self.slow * 0.1**level * (1 if request.cameras[0].width > 40 else 0.05)
        return replace(super().render(request), levels=(level,), coarsest=level == self.last)


def replies(serve: Serve, backend: FakeBackend, fps: float | None, count: int) -> list[Reply]:
    async def main() -> list[Reply]:
        async with serve(backend, ServerConfig(port=0, fps=fps)) as server, Client(server.url) as client:
            return [await client.render(eyes(64)) for _ in range(count)]

    return asyncio.run(main())


def test_replies_name_the_levels_and_the_size(serve: Serve, stopped: Stopped) -> None:
    coarse = replies(serve, Levels(clock=stopped), 40, 12)
    assert "detail" not in coarse[0].info
    last = coarse[-1].info
    assert last["detail"] == {"levels": [1], "bias": last["detail"]["bias"], "scale": 1.0}
    assert last["detail"]["bias"] <= -1 and last["size"] == [64, 64]
    small = replies(serve, Levels(clock=stopped, last=0), 40, 30)
    scale = small[-1].info["detail"]["scale"]
    side = round(64 * scale)
    assert scale < 0.7 and small[-1].info["size"] == [side, side]
    assert [image.shape for image in small[-1].images()] == [(side, side, 3)] * 2
    first, last = small[0].info["eyes"][0], small[-1].info["eyes"][0]
    assert np.allclose(np.array(last["K"]), np.array(first["K"]) * scale, rtol=0.02)
    assert last["viewmat"] == first["viewmat"]


@pytest.mark.parametrize("fps", [None, 5.0])
def test_replies_say_nothing_where_nothing_was_taken(serve: Serve, stopped: Stopped, fps: float | None) -> None:
    backend = Levels(clock=stopped, last=0)
    assert all("detail" not in reply.info for reply in replies(serve, backend, fps, 12))
    assert {request.detail for request in backend.drawn} == {0.0} and backend.drawn[0].viewer > 0
