"""Costs of avatars of different kinds at the same sizes, of unused features, and of frames in which nothing moves."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from typing import Any

import moderngl
import numpy as np

from glsplat.avatar import Avatar, splats_of
from glsplat.camera import Camera
from glsplat.config import RenderConfig, with_fields
from glsplat.extras.evaluate.frames import STAGES, WARM_UP, Series, timed, triangles_of
from glsplat.extras.evaluate.subjects import Subject, orbit, pose_of_frame
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.scene import Rigged
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

PAPER = {512: (21.78, 37.47), 768: (23.19, 38.33), 1024: (25.45, 38.80)}
"""Ms per frame (with, without) Binocular Batching by picture side in pixels: the paper's rendering performance.

Measured by its authors on their GPU with their avatars; its FPS column is 1000 / ms, without encoding.
"""

SIZES = tuple(PAPER)

_STIR = 1e-9
"""Metres that a pose moves per frame, so that the skin pass runs without changing the picture."""


def costs(
    context: Context,
    figures: Mapping[str, Rigged],  # by name; of one person, as all have one camera
    sizes: Sequence[int] = SIZES,  # side of each eye's picture in pixels
    frames: int = 30,  # measured, after a warm-up
    tick: Callable[[], object] = lambda: None,  # called after each frame of each avatar
) -> list[dict[str, Any]]:
    """Return a row per avatar and size as JSON values, with the paper's values at this size.

    Times are median ms per frame, read back: ``pair_ms`` both eyes in one call, ``two_ms`` each eye by its own
    renderer, ``in_turn_ms`` eye by eye by one renderer, which poses once; ``gain`` is ``two_ms / pair_ms``. ``bytes``
    is the GPU memory of a renderer of pairs: the avatar and work buffers. Avatars take turns frame by frame, with the
    same motion and orbiting cameras.
    """
    rows: list[dict[str, Any]] = []
    for size in sizes if figures else ():
        samples: dict[str, list[tuple[float, float, float]]] = {name: [] for name in figures}
        with ExitStack() as stack:
            drawn = {
                name: [
                    stack.enter_context(Renderer(figure, size=(size, size), views=views, context=context))
                    for views in (2, 1, 1, 1)
                ]
                for name, figure in figures.items()
            }
            for frame in range(WARM_UP + frames):
                eyes = orbit(next(iter(figures.values())), frame, size)
                for name, figure in figures.items():
                    taken = _milliseconds(drawn[name], eyes, pose_of_frame(figure.skeleton, frame))
                    if frame >= WARM_UP:
                        samples[name].append(taken)
                    tick()
            for name, figure in figures.items():
                pair, two, in_turn = np.round(np.median(samples[name], axis=0), 3).tolist()
                row: dict[str, Any] = {"method": name, "size": size}
                if isinstance(figure, Avatar):
                    row |= {"kind": "splats", "count": len(figure.splats)}
                else:
                    row |= {"kind": "triangles", "count": triangles_of(figure)}
                row |= {"bytes": sum(drawn[name][0].nbytes().values()), "pair_ms": pair, "two_ms": two}
                row |= {"in_turn_ms": in_turn, "gain": round(two / pair, 3)}
                if size in PAPER:
                    batched, single = PAPER[size]
                    row["paper"] = {"pair_ms": batched, "two_ms": single, "gain": round(single / batched, 3)}
                rows.append(row)
    return rows


def _milliseconds(renderers: Sequence[Renderer], eyes: Sequence[Camera], pose: Pose) -> tuple[float, float, float]:
    """Return ms of one frame as a pair, by a renderer per eye, and eye by eye by one renderer."""
    pair, shared, *own = renderers
    pair.render(eyes, pose)
    two = in_turn = 0.0
    for renderer, eye in zip(own, eyes, strict=True):
        renderer.render([eye], pose)
        two += renderer.timings["total"]
    for eye in eyes:
        shared.render([eye], pose)
        in_turn += shared.timings["total"]
    return pair.timings["total"], two, in_turn


@dataclass(frozen=True, eq=False)
class Feature:
    """One picture drawn twice: with only what the scene needs, and with an unused feature."""

    name: str
    lean: tuple[Splats | Avatar, RenderConfig]
    full: tuple[Splats | Avatar, RenderConfig]
    how: str  # the feature is present but unused
    tolerance: float = 0.01  # largest difference of the pictures: rounding may cut off a pixel at alpha 1/255


def features_of(scene: Splats | Avatar, context: Context) -> list[Feature]:
    """Return the features that a scene can have without changing its picture."""
    splats, config = splats_of(scene), RenderConfig()
    plain = replace(splats, sh=np.ascontiguousarray(splats.sh[:, :1]))
    padded = replace(plain, sh=np.pad(plain.sh, ((0, 0), (0, 15), (0, 0))))
    one = Skeleton.from_joints(("root",), [-1], np.zeros((1, 3)))
    still = _bound(plain, one, 1)
    out = [
        Feature("skinning", (plain, config), (still, config), "one bone that does not turn; the skin pass runs"),
        Feature("SH degree 3", (plain, config), (padded, config), "coefficients above degree 0 are zero"),
        Feature("4 influences", (still, config), (_bound(plain, one, 4), config), "all weight on the first of four"),
        Feature("8 influences", (still, config), (_bound(plain, one, 8), config), "all weight on the first of eight"),
        Feature(
            "nearest rotation",
            (_bound(plain, one, 4), with_fields(config, rotation="raw")),
            (_bound(plain, one, 4), config),
            "polar instead of raw, on a bone that does not turn",
        ),
        Feature(
            "rotation kept for SH",
            (padded, config),
            (_bound(padded, one, 1), config),
            "one bone that does not turn, under SH degree 3 of zeros",
        ),
        Feature(
            "antialias",
            (plain, with_fields(config, eps2d=0.0, antialias=False)),
            (plain, with_fields(config, eps2d=0.0, antialias=True)),
            "without dilation the compensation is one",
        ),
        Feature(
            "extent cut-off",
            (plain, config),
            (plain, replace(config, max_sigma=3.3299)),
            "at 3.3299 instead of 3.33 sigma",
            tolerance=0.02,
        ),
    ]
    everywhere = np.tile(np.array([0, 0, 0, -127], np.int8), (len(plain), 1))
    bare = replace(plain, cones=None)
    out.append(
        Feature(
            "hidden splats",
            (bare, config),
            (replace(plain, cones=everywhere), replace(config, cull_hidden=True)),
            "cones that hold every direction; what shines through is made up for all the same",
            tolerance=0.15,  # of the lift at alpha 2/3 (lift.glsl)
        )
    )
    if context.vertex_layers:
        routed = with_fields(config, layers="geometry")
        out.append(Feature("geometry shader", (plain, config), (plain, routed), "this driver does not need it"))
    return out


def left_out(context: Context, subject: Subject, features: Sequence[Feature], frames: int) -> list[dict[str, Any]]:
    """Return a row per feature: both interleaved times, programs, passes, buffers, and the pictures' difference."""
    return [_compare(context, subject, feature, frames) for feature in features]


def _compare(context: Context, subject: Subject, feature: Feature, frames: int) -> dict[str, Any]:
    sides = {"lean": feature.lean, "full": feature.full}
    size = (subject.views(0)[0].width, subject.views(0)[0].height)
    quick: dict[str, Renderer] = {}
    staged: dict[str, Renderer] = {}
    totals: dict[str, list[tuple[float, float]]] = {side: [] for side in sides}
    passes: dict[str, set[str]] = {side: set() for side in sides}
    buffers: dict[str, int] = {}
    try:
        for side, (scene, config) in sides.items():
            before = _buffers()
            quick[side] = Renderer(scene, size=size, views=2, config=config, context=context)
            quick[side].render(subject.views(0), _stirred(scene, 0))
            buffers[side] = _buffers() - before
            staged[side] = Renderer(
                scene, size=size, views=2, config=replace(config, output="float32"), context=context, timed=True
            )
        apart = 0.0
        for frame in range(WARM_UP + frames):
            views, images = subject.views(frame), {}
            # the first one finds colder caches: take turns
            for side in sorted(sides, reverse=bool(frame % 2)):
                pose = _stirred(sides[side][0], frame)
                taken, _ = timed(lambda: quick[side].render(views, pose))  # noqa: B023 - called at once
                images[side] = staged[side].render(views, pose)
                if frame >= WARM_UP:
                    totals[side].append(taken)
                    passes[side] |= staged[side].timings.keys()
            apart = max(apart, float(np.nan_to_num(np.abs(images["lean"] - images["full"]), nan=1e3).max()))
        row: dict[str, Any] = {"feature": feature.name, "how": feature.how}
        for side in sides:
            row[side] = {
                "ms": asdict(Series.of_times(totals[side])),
                "programs": quick[side].programs_compiled,
                "passes": [stage for stage in STAGES if stage in passes[side]],
                "bytes": quick[side].nbytes(),
                "buffers": buffers[side],
            }
    finally:
        for renderer in (*quick.values(), *staged.values()):
            renderer.release()
    row |= {
        "cost": round(row["full"]["ms"]["median"] / row["lean"]["ms"]["median"], 3),
        "apart": apart,
        "same_picture": apart <= feature.tolerance,
    }
    return row


def unmoved(context: Context, subject: Subject, frames: int) -> dict[str, Any]:
    """Return passes and times of frames after a motion, and of the same frames drawn once more."""
    size = (subject.views(0)[0].width, subject.views(0)[0].height)
    with Renderer(subject.scene, size=size, views=2, context=context) as renderer:
        moved: list[tuple[float, float]] = []
        still: list[tuple[float, float]] = []
        stages: dict[str, list[str]] = {}
        for frame in range(WARM_UP + frames):
            for name, series in (("moved", moved), ("unmoved", still)):
                views, pose = subject.views(frame), subject.pose(frame)
                taken, _ = timed(lambda: renderer.render(views, pose))  # noqa: B023 - called at once
                stages[name] = [stage for stage in STAGES if stage in renderer.timings]
                if frame >= WARM_UP:
                    series.append(taken)
    return {
        "scene": subject.name,
        "moved_ms": asdict(Series.of_times(moved)),
        "unmoved_ms": asdict(Series.of_times(still)),
        "moved_passes": stages["moved"],
        "unmoved_passes": stages["unmoved"],
    }


def _buffers() -> int:
    """Return the number of GL buffers."""
    gc.collect()
    # type(), not isinstance(), which fails for dead weak proxies
    return sum(issubclass(type(item), moderngl.Buffer) for item in gc.get_objects())


def _bound(splats: Splats, skeleton: Skeleton, influences: int) -> Avatar:
    """Bind all splats to the first joint; the other ``influences - 1`` weights are 0."""
    joints = np.zeros((len(splats), influences), np.uint16)
    weights = np.zeros((len(splats), influences), np.float32)
    weights[:, 0] = 1
    return Avatar(splats, skeleton, Skin(joints, weights))


def _stirred(scene: Splats | Avatar, frame: int) -> Pose | None:
    if not isinstance(scene, Avatar):
        return None
    return Pose(np.zeros((len(scene.skeleton), 3)), np.array([0.0, 0.0, _STIR * frame]))
