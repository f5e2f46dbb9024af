"""Adaptive quality against a machine whose pictures take as long as a formula says: does it hold the rate, and rest?"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.net.pace.adaptive_quality import BIAS, FULL, SCALES, AdaptiveQuality, Detail

Cost = Callable[[Detail, float], float]
History = list[tuple[float, int, Detail]]


def level_of(detail: Detail, coarsest: int = 3) -> int:
    return int(min(-detail.bias // 1, coarsest))


def machine(full: float, coarsest: int = 3, noise: float = 0.03, seed: int = 0) -> Cost:
    """Seconds of a picture: half a level, half the splats; the size counts for a third."""
    rng = np.random.default_rng(seed)

    def cost(detail: Detail, now: float) -> float:
        splats = 0.5 ** level_of(detail, coarsest)
        return full * splats * (2 / 3 + detail.scale**2 / 3) * float(rng.normal(1, noise))

    return cost


def run(
    adaptive_quality: AdaptiveQuality, costs: dict[int, Cost], seconds: float, start: float = 0.0
) -> list[tuple[float, int, Detail]]:
    """Viewers in turn, as often as the machine can, 72 times a second at most; what each picture was drawn with."""
    now = start
    history: History = []
    while now < start + seconds:
        before = now
        for viewer, cost in costs.items():
            detail = adaptive_quality.detail(viewer, now)
            took = cost(detail, now)
            now += took
            adaptive_quality.drawn(viewer, took, level_of(detail, 3) == 3, now)
            history.append((now, viewer, detail))
        now = max(now, before + 1 / 72)
    return history


def changes(history: History, viewer: int = 1) -> int:
    details = [detail for _, one, detail in history if one == viewer]
    return sum(a != b for a, b in pairwise(details))


def test_nothing_is_taken_away_that_there_is_time_for() -> None:
    history = run(AdaptiveQuality(45), {1: machine(0.015)}, 20)
    assert {detail for _, _, detail in history} == {FULL}


@pytest.mark.parametrize(("full", "bias", "scale"), [(0.04, -1, 1), (0.08, -2, 1), (0.2, -3, 0.75), (5.0, -3, 0.5)])
def test_levels_go_first_then_the_size(full: float, bias: float, scale: float) -> None:
    adaptive_quality = AdaptiveQuality(45)
    history = run(adaptive_quality, {1: machine(full, noise=0.01)}, 90)
    last = history[-1][2]
    assert (level_of(last), last.scale) == (-bias, scale)
    if full < 5:
        late = [now for now, _, _ in history if now > 60]
        assert len(late) / 30 >= 40  # pictures a second
    order = [detail for _, _, detail in history]
    assert all(detail.scale == 1 or level_of(detail) == 3 for detail in order)


@pytest.mark.check
def test_it_does_not_swing() -> None:
    """A level that takes 0.97 of the time, its finer one far too long: tried again, but ever less often."""
    history = run(AdaptiveQuality(45), {1: machine(0.043, noise=0.01)}, 600)
    early = [entry for entry in history if entry[0] < 100]
    late = [entry for entry in history if entry[0] > 400]
    assert changes(late) <= 8 and changes(early) >= 2  # bias by halves: two steps a level


def test_what_was_taken_comes_back() -> None:
    adaptive_quality = AdaptiveQuality(45)
    busy = run(adaptive_quality, {1: machine(0.08)}, 20)
    assert busy[-1][2] != FULL
    idle = run(adaptive_quality, {1: machine(0.008)}, 60, start=busy[-1][0])
    assert idle[-1][2] == FULL


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


@pytest.mark.parametrize("others", [1, 8, 16])
def test_those_who_hardly_ask_take_nothing_from_the_others(others: int) -> None:
    """Somebody who opens many connections and asks each for a tiny picture a second costs what it costs."""
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
    """A program that is compiled, another process: what was slow for a moment is back soon."""
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
    """Pictures whose time hardly depends on the size: by their pixels alone the next size would take too much."""
    adaptive_quality, drawn = AdaptiveQuality(40), []
    for picture in range(200):
        now = picture / 40
        drawn.append(adaptive_quality.detail(1, now).scale)
        adaptive_quality.drawn(1, (0.8 if drawn[-1] == 1 else 0.7) / 40, True, now)
        if picture == 20:
            adaptive_quality.refused(1, now)
    assert drawn[20:22] == [1.0, SCALES[1]] and drawn[-1] == 1.0


def test_without_a_rate_nothing_is_taken() -> None:
    adaptive_quality = AdaptiveQuality(None)
    for i in range(20):
        assert adaptive_quality.detail(1, float(i)) == FULL
        adaptive_quality.drawn(1, 9.0, False, float(i))
    assert not adaptive_quality._states
