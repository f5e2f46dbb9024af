"""Extreme inputs of a frame, each with a stated behaviour (docs/conventions.md) that is tested."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat import reference
from glsplat.camera import PAPER_FOV, Camera, look_at, pinhole, sorting_camera, stereo_cameras
from glsplat.config import RenderConfig, with_fields
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.difference import Difference
from glsplat.gl.context import Context
from glsplat.renderer.probe import Probe
from glsplat.scene import SceneLike
from glsplat.splats import SH_C0, Splats

SIZE = 64


@dataclass(frozen=True)
class Outcome:
    """The outcome of a case."""

    held: bool  # whether it behaved as stated
    error: float | None  # the largest against float64, in ``unit``; None: nothing is compared
    unit: str = ""
    seen: str = ""  # in words
    splats: int | None = None  # fewest splats that still fail


@dataclass(frozen=True)
class Case:
    """One extreme input with its stated behaviour and its test."""

    group: str
    name: str
    input: str
    behaviour: str
    check: Callable[[Context], Outcome]


def judge(cases: Sequence[Case], context: Context) -> list[dict[str, Any]]:
    """Run every case and return its row; a case that raises any exception has failed."""
    rows = []
    for case in cases:
        try:
            outcome = case.check(context)
        except Exception as error:
            outcome = Outcome(False, None, seen=f"{type(error).__name__}: {error}")
        stated = {"group": case.group, "case": case.name, "input": case.input, "behaviour": case.behaviour}
        found = {name: getattr(outcome, name) for name in ("seen", "error", "unit", "splats")}
        rows.append(stated | found | {"verdict": "holds" if outcome.held else "failed"})
    return rows


def camera(width: int = SIZE, height: int | None = None, fov: float = PAPER_FOV) -> Camera:
    """Return a camera three metres in front of the origin; square without ``height``."""
    height = width if height is None else height
    return Camera(look_at((0, 0, 3.0), (0, 0, 0)), pinhole(width, height, fov), width, height)


def renderer(
    scene: SceneLike, context: Context, size: tuple[int, int] = (SIZE, SIZE), views: int = 1, **config: Any
) -> Probe:
    """Return a renderer whose pictures are the 32F target."""
    settings = with_fields(RenderConfig(output="float32", target="32f"), **config)
    return Probe(scene, size=size, views=views, config=settings, context=context)


def cloud(count: int = 300, degree: int = 0, centre: Sequence[float] = (0, 0, 0)) -> Splats:
    """Return random anisotropic splats of mixed opacity around ``centre``."""
    rng = np.random.default_rng(11)
    sh = rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3))
    return Splats.create(
        rng.normal(0, 0.5, (count, 3)) + centre,
        rng.normal(size=(count, 4)),
        np.exp(rng.uniform(-5, -2.5, (count, 3))),
        rng.uniform(0.01, 1, count),
        sh,
    )


def picture_case(
    name: str, input_: str, behaviour: str, scene: Splats, views: Sequence[Camera], expected: Splats | None = None
) -> Case:
    """Return a case: the picture of ``scene`` is that of ``expected`` (default: itself) in float64, by the 32F gate."""

    def check(context: Context) -> Outcome:
        with renderer(scene, context, (views[0].width, views[0].height), len(views)) as drawn:
            return compared(drawn.render(views), reference.render(scene if expected is None else expected, views))

    return Case("one frame", name, input_, behaviour, check)


def compared(image: NDArray[np.float32], expected: NDArray[np.float64]) -> Outcome:
    """Return whether a picture is within the 32F gate, with its largest error."""
    error = Difference.of(image, expected, flip=False)
    return Outcome(bool(np.isfinite(image).all()) and error.contract, error.maximum, "of 1", f"{error.psnr:.1f} dB")


def frame_cases() -> list[Case]:
    """Return cases of single extreme splats, of splats that must not be drawn, and of whole frames."""
    exact = "as float64 has it"
    hard: dict[str, tuple[dict[str, Any], str]] = {
        "needle 1e6:1": ({"scales": [[1.0, 1e-6, 1e-6]], "quats": [[0.9, 0.1, 0.3, 0.2]]}, exact),
        "needle 1e12:1": ({"scales": [[1.0, 1e-12, 1e-12]], "quats": [[0.2, 0.7, 0.3, 0.9]]}, exact),
        "smaller than a pixel": ({"scales": [[1e-9] * 3]}, "a dot of the dilation's size"),
        "one scale zero": ({"scales": [[0.1, 0.0, 0.1]]}, "a flat splat"),
        "all scales zero": ({"scales": [[0.0] * 3]}, "a dot of the dilation's size"),
        "negative scale": ({"scales": [[-0.1, 0.1, 0.1]]}, "the sign has no meaning"),
        "fills the screen": ({"scales": [[50.0] * 3]}, exact),
        "a thousand kilometres": ({"scales": [[1e6] * 3]}, exact),
        "opacity 1": ({"opacities": [1.0]}, "alpha is at most 0.99"),
        "opacity 2": ({"opacities": [2.0]}, "clamped to 1"),
        "bright and negative": ({"rgb": [[30.0, 0.0, -5.0]]}, "no upper clamp, below zero is zero"),
        "on the near plane": ({"means": [[0.0, 0.0, 2.99]]}, "not drawn at z <= near"),
        "in front of the near plane": ({"means": [[0.001, 0.0, 2.985]], "scales": [[0.01] * 3]}, exact),
        "far off the axis": ({"means": [[40.0, 0.0, 2.0]], "scales": [[20.0, 0.1, 0.1]]}, "clamped Jacobian"),
        "long quaternion": ({"quats": [[3e8, 1e8, -2e8, 5e8]]}, "normalised"),
    }
    gone: dict[str, tuple[dict[str, Any], str]] = {
        "opacity 0": ({"opacities": [0.0]}, "transparent"),
        "opacity 0.0039": ({"opacities": [0.0039]}, "transparent"),
        "opacity -1": ({"opacities": [-1.0]}, "transparent"),
        "behind the camera": ({"means": [[0.0, 0.0, 4.0]]}, "out of range"),
        "outside the picture": ({"means": [[9.0, 0.0, 0.0]]}, "outside"),
        "covariance overflows": ({"scales": [[1e30] * 3]}, "degenerate"),
        "NaN position": ({"means": [[np.nan, 0.0, 0.0]]}, "skipped"),
        "infinite scale": ({"scales": [[np.inf, 1.0, 1.0]]}, "skipped"),
        "NaN colour": ({"rgb": [[np.nan, 0.0, 0.0]]}, "skipped"),
        "infinite opacity": ({"opacities": [np.inf]}, "skipped"),
        "zero quaternion": ({"quats": [[0.0] * 4]}, "skipped"),
    }
    cases = [
        picture_case(name, _words(changes), behaviour, _one(changes), [camera()])
        for name, (changes, behaviour) in hard.items()
    ]
    cases += [
        Case(
            "one frame", name, _words(changes), f"nothing drawn, counted as {reason!r}", _counted(_one(changes), reason)
        )
        for name, (changes, reason) in gone.items()
    ]
    return cases + _whole_frames()


def _whole_frames() -> list[Case]:
    exact, few = "as float64 has it", cloud()
    pair = list(stereo_cameras(head(3.0), 0.2, size=(SIZE, SIZE)))
    ties = replace(cloud(2000), means=np.zeros((2000, 3), np.float32))
    bad = few.means.copy()
    bad[::7] = np.nan
    dropped = few.take(np.isfinite(bad).all(axis=1))
    far = (1e5, -2e5, 5e4)
    away = Camera(look_at((far[0], far[1], far[2] + 3), far), pinhole(SIZE, SIZE), SIZE, SIZE)
    outlier = few.take(np.r_[0, np.arange(len(few))])
    outlier = replace(outlier, means=np.vstack([[[0, 0, -1e6]], outlier.means[1:]]))
    single = camera(1)
    return [
        picture_case("no splats", "an empty scene", "the background", few.take([]), pair),
        picture_case("1 x 1 pixel", "300 splats", exact, few, [single]),
        picture_case("equal depths", "2,000 splats at one place", "the lower index is the nearer", ties, [camera()]),
        picture_case("bad among good", "every 7th position NaN", "the others as without them",
                     replace(few, means=bad), pair, expected=dropped),
        picture_case("far from the origin", f"a scene and its camera at {far} m", exact, cloud(centre=far), [away]),
        picture_case("outlier", "one splat a thousand kilometres away", "no effect on the order", outlier, pair),
        picture_case("SH degree 3", "random coefficients", exact, cloud(degree=3), pair),
        Case("one frame", "pair against singles", "both eyes of one pass", "each eye bit for bit its single render",
             _pair_is_singles),
        Case("one frame", "repeats", "one frame rendered three times from scratch", "the same bytes", _repeats),
    ]  # fmt: skip


def _one(changes: dict[str, Any]) -> Splats:
    values: dict[str, Any] = {
        "means": [[0.0, 0, 0]],
        "quats": [[1.0, 0, 0, 0]],
        "scales": [[0.1] * 3],
        "opacities": [0.8],
        "rgb": [[1.0, 0.2, 0.1]],
        **changes,
    }
    sh = (np.array(values.pop("rgb"))[:, None] - 0.5) / SH_C0  # ``rgb`` accepts no values far from 0 to 1
    return Splats.create(**values, sh=sh)


def _words(changes: dict[str, Any]) -> str:
    def number(value: Any) -> str:
        return ", ".join(f"{v:g}" for v in np.ravel(value))

    return "; ".join(f"{name} {number(value)}" for name, value in changes.items())


def _counted(scene: Splats, reason: str) -> Callable[[Context], Outcome]:
    def check(context: Context) -> Outcome:
        with renderer(scene, context) as drawn:
            image = drawn.render([camera()])
            counts = {"skipped": drawn.stats.skipped, **drawn.stats.culled}
        counted = {name: count for name, count in counts.items() if count}
        held = counted == {reason: 1} and not image.any()
        return Outcome(held, float(np.abs(image).max()), "of 1", ", ".join(counted) or "drawn")

    return check


def _pair_is_singles(context: Context) -> Outcome:
    scene, views = cloud(degree=1), list(stereo_cameras(head(3.0), 0.2, size=(SIZE, SIZE)))
    with renderer(scene, context, views=2) as both, renderer(scene, context) as one:
        pair = both.render(views)
        alone = [one.in_order(sorting_camera(views), [view])[0] for view in views]
    error = float(np.abs(pair - np.stack(alone)).max())
    return Outcome(error == 0, error, "of 1", "identical" if error == 0 else "different")


def _repeats(context: Context) -> Outcome:
    images = []
    for _ in range(3):
        with renderer(cloud(), context) as drawn:
            images.append(drawn.render([camera()]))
    error = float(max(np.abs(image - images[0]).max() for image in images))
    return Outcome(error == 0, error, "of 1", "identical" if error == 0 else "different")


def refused(kind: type[GlsplatError], words: str, make: Callable[[], object]) -> Callable[[Context], Outcome]:
    """Return a check that ``make`` raises ``kind`` with ``words`` in its message."""

    def check(_: Context) -> Outcome:
        try:
            make()
        except kind as error:
            return Outcome(words in str(error), None, seen=str(error))
        return Outcome(False, None, seen="accepted")

    return check


def head(distance: float) -> NDArray[np.float64]:
    """Return the pose [4, 4] of a head ``distance`` metres in front of the origin."""
    pose = np.eye(4)
    pose[2, 3] = distance
    return pose
