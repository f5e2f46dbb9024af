"""Cases of a report: extreme sizes, views and places, and the poses that a room extrapolates."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from glsplat import reference
from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
from glsplat.extras.evaluate.stability.frame import (
    SIZE,
    Case,
    Outcome,
    camera,
    cloud,
    compared,
    frame_cases,
    head,
    picture_case,
    renderer,
)
from glsplat.extras.evaluate.stability.skin import skin_cases
from glsplat.extras.evaluate.stability.tracking import tracking_cases
from glsplat.gl.context import Context
from glsplat.optional import plugin
from glsplat.rotations import turn_between
from glsplat.scene import Item, Scene
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats

LARGEST = 8192  # largest side of a target, in pixels, of every driver of OpenGL 4

MILLION = 10**6

_EXACT = "as float64 has it"
_NEEDLE_ERROR = 0.02
_SAMPLES_S = 0.05  # between the two samples that give the speed
_MAX_TURN, _MAX_STEP_M = 0.5, 0.3  # radians of a joint and metres of the root that a room extrapolates at most


def all_cases() -> list[Case]:
    """Return the cases of a report."""
    return [*frame_cases(), *extreme_cases(), *skin_cases(), *tracking_cases()]


def extreme_cases() -> list[Case]:
    """Return cases of whole frames at the limits of sizes, views and places, and of rooms if installed."""
    few = cloud()
    pair = list(stereo_cameras(head(3.0), 0.2, size=(1, 1)))
    wide = [picture_case(f"{fov:g} degrees of view", "300 splats", _EXACT, few, [camera(fov=fov)])
            for fov in (0.01, 1, 170, 179.9)]  # fmt: skip
    return [
        *wide,
        picture_case("8,192 pixels wide", f"300 splats, {LARGEST} x 16", _EXACT, few, [camera(LARGEST, 16)]),
        picture_case("8,192 pixels high", f"300 splats, 16 x {LARGEST}", _EXACT, few, [camera(16, LARGEST, 170)]),
        picture_case("a pair of 1 x 1 pixel", "300 splats", _EXACT, few, pair),
        Case("one frame", "a million splats in one pixel", "the 1,000 nearest red and opaque, the others blue",
             "red at alpha 1; no driver limit, no lost order", _million),
        Case("one frame", "scales from 1e-7 to 1e4 m", "a sphere, and to 1e3 m a needle of 1 mm, of each power of ten",
             _EXACT, _scales),
        Case("one frame", "needle of 10 km by 1 mm", "the largest scale beside a small one",
             f"within {_NEEDLE_ERROR:g} of float64", _needle),
        *(Case("one frame", f"an item placed {metres:g} m away", "its camera beside it", "the picture at the origin",
               partial(_placed, metres=metres)) for metres in (1e3, 1e5)),
        *_room_cases(),
    ]  # fmt: skip


def _million(context: Context) -> Outcome:
    """Check the middle pixel, which contains all splats."""
    rng, view = np.random.default_rng(2), camera(15)
    z = np.sort(rng.uniform(-0.5, 0.5, MILLION))[::-1]
    means = np.stack([*rng.uniform(-1e-3, 1e-3, (2, MILLION)), z], axis=1)
    rgb = np.tile([0.0, 0.0, 1.0], (MILLION, 1))
    rgb[:1000] = 1.0, 0.0, 0.0
    opacities = np.full(MILLION, 0.5)
    opacities[:1000] = 1.0
    order, quats = rng.permutation(MILLION), np.tile([1.0, 0, 0, 0], (MILLION, 1))
    sizes = np.full((MILLION, 3), 0.05)
    scene = Splats.create(means[order], quats, sizes, opacities[order], rgb=rgb[order])
    with renderer(scene, context, (15, 15)) as drawn:
        pixel = drawn.render([view])[0, 7, 7]
    error = float(np.abs(pixel - (1, 0, 0, 1)).max())
    return Outcome(error <= 1e-3, error, "of 1", f"{MILLION:,} splats")


def _scales(context: Context) -> Outcome:
    found = [_sized(context, [10.0**power] * 3) for power in range(-7, 5)]
    found += [_sized(context, [10.0**power, 1e-3, 1e-3]) for power in range(-7, 4)]
    worst = max(one.error or 0.0 for one in found)
    return Outcome(all(one.held for one in found), worst, "of 1", f"{len(found)} splats")


def _needle(context: Context) -> Outcome:
    """Check a splat whose covariance exceeds float32, with its own bound."""
    found = _sized(context, [1e4, 1e-3, 1e-3])
    return Outcome((found.error or 0.0) <= _NEEDLE_ERROR, found.error, "of 1", found.seen)


def _sized(context: Context, scales: list[float]) -> Outcome:
    scene = Splats.create([[0, 0, 0]], [[0.9, 0.1, 0.3, 0.2]], [scales], [0.8], rgb=[[1.0, 0.2, 0.1]])
    with renderer(scene, context) as drawn:
        return compared(drawn.render([camera()]), reference.render(scene, [camera()]))


def _placed(context: Context, metres: float) -> Outcome:
    far, few = np.array([metres, -metres, metres]) / np.sqrt(3), cloud()
    matrix = np.eye(4)
    matrix[:3, 3] = far
    view = Camera(look_at(far + (0, 0, 3.0), far), pinhole(SIZE, SIZE), SIZE, SIZE)
    with renderer(Scene([Item(few, transform=matrix)]), context) as drawn:
        return compared(drawn.render([view]), reference.render(few, [camera()]))


def _room_cases() -> list[Case]:
    module = plugin("rooms.person")
    if module is None:
        return []

    def moved(first: Pose, second: Pose, seconds: float = _SAMPLES_S) -> tuple[Pose, Pose]:
        """Return the pose 0.1 s and 5 s after the second sample."""
        person = module.Person(0, "a", "a", np.eye(4), "", 0.0)
        person.add_sample(module.PoseSample(first, 0.0))
        person.add_sample(module.PoseSample(second, seconds))
        soon, late = (person.extrapolated(seconds + after)[0] for after in (0.1, 5.0))
        return soon, late

    def bounded(first: Pose, second: Pose) -> Outcome:
        soon, late = moved(first, second)
        step = float(np.linalg.norm(soon.trans - second.trans))
        turn = float(np.linalg.norm(turn_between(second.rotations, soon.rotations), axis=1).max())
        held = step <= _MAX_STEP_M + 1e-6 and turn <= _MAX_TURN + 1e-6 and _same(soon, late)
        return Outcome(held, step, "m", f"a joint turns {turn:.2f} rad on")

    def kept(first: Pose, second: Pose, seconds: float = _SAMPLES_S) -> Outcome:
        soon, late = moved(first, second, seconds)
        return Outcome(_same(soon, second) and _same(late, second), 0.0, "m", "the last pose")

    rest, out = Pose(np.zeros((3, 3)), np.zeros(3)), "at most 0.5 rad and 0.3 m further, held after 0.1 s"
    fast = Pose(np.full((3, 3), 0.5), np.array([0.4, 0, 0]))
    half = Pose(np.array([[0, 3.1, 0], [3.1, 0, 0], [0, 0, -3.1]]), np.zeros(3))
    edge = [Pose(np.zeros((3, 3)), np.array([x, 0, 0])) for x in (1e6 - 0.1, 1e6 - 0.01)]
    rows: list[tuple[str, str, str, Any]] = [
        ("a fast sample", "8 m/s and 17 rad/s", out, lambda _: bounded(rest, fast)),
        ("half turns between samples", "177.6 degrees in 50 ms", out, lambda _: bounded(rest, half)),
        ("two samples of one time", "0 s apart", "the last pose", lambda _: kept(rest, fast, 0.0)),
        (
            "extrapolated out of bounds",
            "0.1 m from the limit of 1e6 m",
            "the last pose",
            lambda _: kept(edge[0], edge[1]),
        ),
    ]
    return [Case("rooms", *row) for row in rows]


def _same(one: Pose, other: Pose) -> bool:
    return bool(np.allclose(one.rotations, other.rotations, atol=1e-6) and np.allclose(one.trans, other.trans))
