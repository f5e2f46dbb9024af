"""How time and memory grow with splats, pixels and views: the default avatar in motion, made smaller and larger."""

from __future__ import annotations

import gc
import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.data import default_avatar
from glsplat.extras.evaluate.frames import FOV, STAGES, Series, timed
from glsplat.extras.evaluate.subjects import Subject
from glsplat.gl.context import Context, create_context
from glsplat.renderer import Renderer
from glsplat.skinning.skin import Skin
from glsplat.views import orbited, view_of, viewing_point

WARM_UP = 2
HEADS_APART = 10.0
"""Degrees between the heads of four and eight views, which are two and four pairs."""


@dataclass(frozen=True)
class Grid:
    """What is tried along each axis while the other two stay; pixels are a side of each view."""

    splats: tuple[int, ...]
    pixels: tuple[int, ...]
    views: tuple[int, ...]
    size: int = 512  # pixels a side where splats and views vary
    frames: int = 12
    alone: bool = True  # memory of the process too: each point once more in a process of its own, about 1 s each
    longest: float = 60.0  # seconds that one point may take; larger ones are left out

    @property
    def staged(self) -> int:
        """Frames of the renderer that waits at every stage."""
        return max(2, self.frames // 4)


def grid_of(quick: bool) -> Grid:
    """The points of a report."""
    if quick:
        return Grid((1_000, 10_000, 100_000), (256, 512, 1024), (1, 2, 4), size=256, frames=3, alone=False)
    counts = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
    return Grid(counts, (256, 512, 1024, 2048), (1, 2, 4, 8))


def growth(context: Context, grid: Grid, device: str | None = None) -> dict[str, Any]:
    """Rows a point of each axis, and straight lines through them: ns a splat, ns a pixel, ms a view.

    Memory is what the renderer says it has on the GPU, and what a fresh process on ``device`` grows by while a renderer
    is made and draws its first frames (a software driver keeps the former there; None where the system does not tell).
    """
    avatar = default_avatar()
    out: dict[str, Any] = {"size": grid.size, "frames": grid.frames, "scene": "default avatar, in motion"}
    for axis, points in _points(grid).items():
        out[axis] = _along(context, avatar, grid, axis, points, device)
    out["fits"] = _fits(out)
    return out


def resampled(avatar: Avatar, count: int, seed: int = 0) -> Avatar:
    """The avatar with another number of splats of the same area in all: some of them enlarged, or several for each.

    Made for timing only: copies lie beside each other at random, in the plane of the splat they come from.
    """
    have = len(avatar.splats)
    rng = np.random.default_rng(seed)
    times = -(-count // have)
    index = np.sort(rng.permutation(have * times)[:count]) // times
    splats, shrink = avatar.splats.take(index), np.float32(np.sqrt(have / count))
    offset = splats.scales * rng.normal(0, 1, splats.scales.shape).astype(np.float32) if times > 1 else 0
    w, xyz = splats.quats[:, :1], splats.quats[:, 1:]
    turned = offset + 2 * np.cross(xyz, np.cross(xyz, offset) + w * offset) if times > 1 else 0
    moved = replace(splats, means=(splats.means + turned).astype(np.float32), scales=splats.scales * shrink)
    return Avatar(moved, avatar.skeleton, Skin(avatar.skin.joints[index], avatar.skin.weights[index]), avatar.meta)


def fitted(x: Sequence[float], y: Sequence[float]) -> dict[str, float] | None:
    """The line y = constant + slope x with the least relative error, and its largest; None for fewer than 3 points."""
    if len(x) < 3:
        return None
    a, b = np.asarray(x, np.float64), np.asarray(y, np.float64)
    slope, constant = np.polyfit(a, b, 1, w=1 / b)
    off = np.abs(constant + slope * a - b) / b
    return {"slope": float(slope), "constant": float(constant), "largest_relative_error": float(off.max())}


def _points(grid: Grid) -> dict[str, list[tuple[int, int, int]]]:
    """(splats, pixels a side, views) by axis; the default avatar and a pair where they do not vary."""
    base = len(default_avatar().splats)
    return {
        "splats": [(n, grid.size, 2) for n in grid.splats],
        "pixels": [(base, side, 2) for side in grid.pixels],
        "views": [(base, grid.size, v) for v in grid.views],
    }


def _along(
    context: Context,
    avatar: Avatar,
    grid: Grid,
    axis: str,
    points: Sequence[tuple[int, int, int]],
    device: str | None,
) -> list[dict[str, Any]]:
    """A row a point: renderers of all of them first, smallest first, then frames in turn, so that noise hits all."""
    rows: list[dict[str, Any]] = []
    shown: list[tuple[dict[str, Any], Renderer, Callable[[Renderer, int], dict[str, float]]]] = []
    with ExitStack() as stack:
        for splats, pixels, views in points:
            row: dict[str, Any] = {"splats": splats, "size": pixels, "views": views, "pixels": views * pixels**2}
            rows.append(row)
            reason = _too_much(rows[:-1], splats, pixels, views, grid)
            if reason:
                row["left_out"] = reason
                continue
            scene = avatar if splats == len(avatar.splats) else resampled(avatar, splats)
            show, size = _show(scene, pixels, views), (pixels, pixels)
            row["process_bytes"] = _grown_apart(splats, pixels, views, device) if grid.alone else None
            if axis == "splats":
                row["stages_ms"] = _stages(context, scene, pixels, views, grid)
            renderer = stack.enter_context(Renderer(scene, size=size, views=views, context=context))
            warm = [show(renderer, frame)["total"] for frame in range(WARM_UP)]
            row["ms"] = asdict(Series.of(warm[1:]))  # what the next, larger point is judged by; replaced below
            row |= {"drawn": renderer.stats.drawn, "bytes": renderer.nbytes()}
            row["gpu_bytes"] = sum(row["bytes"].values())
            shown.append((row, renderer, show))
        times: list[list[tuple[float, float]]] = [[] for _ in shown]
        for frame in range(WARM_UP, WARM_UP + grid.frames):
            for (_, renderer, show), series in zip(shown, times, strict=True):
                series.append(timed(lambda: show(renderer, frame))[0])  # noqa: B023 - called at once
    for (row, _, _), series in zip(shown, times, strict=True):
        row["ms"] = asdict(Series.of_times(series))
    return rows


def _stages(context: Context, scene: Avatar, pixels: int, views: int, grid: Grid) -> dict[str, float]:
    """Milliseconds a stage, from a renderer that waits after each."""
    show = _show(scene, pixels, views)
    with Renderer(scene, size=(pixels, pixels), views=views, context=context, timed=True) as renderer:
        taken = [show(renderer, frame) for frame in range(1 + grid.staged)][1:]
    return {s: float(np.median([t[s] for t in taken])) for s in STAGES if s in taken[0]}


def _show(scene: Avatar, pixels: int, views: int) -> Callable[[Renderer, int], dict[str, float]]:
    """Draws a frame and says what its stages took."""
    subject, around = Subject("", scene, pixels, moving=True), _heads(scene, pixels, views)

    def show(renderer: Renderer, frame: int) -> dict[str, float]:
        renderer.render(around(frame), subject.pose(frame))
        return dict(renderer.timings)

    return show


def _grown_apart(splats: int, pixels: int, views: int, device: str | None) -> int | None:
    """Bytes a process of its own grows by: in this one, memory that others have freed is used again."""
    spawn = multiprocessing.get_context("spawn")  # a forked OpenGL context is of no use
    with ProcessPoolExecutor(1, spawn) as pool:
        try:
            return pool.submit(_grown, splats, pixels, views, device).result(timeout=300)
        except (BrokenProcessPool, TimeoutError):  # killed for its memory, perhaps
            return None


def _grown(splats: int, pixels: int, views: int, device: str | None) -> int | None:
    avatar = default_avatar()
    scene = avatar if splats == len(avatar.splats) else resampled(avatar, splats)
    context = create_context(device)
    try:
        show = _show(scene, pixels, views)
        gc.collect()
        before = resident()
        with Renderer(scene, size=(pixels, pixels), views=views, context=context) as renderer:
            for frame in range(WARM_UP):
                show(renderer, frame)
            after = resident()
    finally:
        context.release()
    return None if before is None or after is None else after - before


def _heads(scene: Avatar, pixels: int, views: int) -> Callable[[int], list[Camera]]:
    """One eye, or pairs of heads around the scene, that all go round by a degree a frame."""
    eye, target = viewing_point(scene, FOV)

    def around(frame: int) -> list[Camera]:
        out: list[Camera] = []
        for head in range(max(1, views // 2)):
            place = orbited(eye, target, np.radians(frame + HEADS_APART * head))
            out += view_of(place, target, (pixels, pixels), FOV, ipd=None if views == 1 else 0.055)
        return out

    return around


def _fits(result: dict[str, Any]) -> dict[str, Any]:
    """Lines through the points that were measured."""

    def line(axis: str, key: str, value: Callable[[dict[str, Any]], float | None]) -> dict[str, float] | None:
        rows = [row for row in result[axis] if "ms" in row and value(row)]
        return fitted([row[key] for row in rows], [value(row) or 0.0 for row in rows])

    stages = [s for s in STAGES if any(row.get("stages_ms", {}).get(s) for row in result["splats"])]
    return {
        "ns_a_splat": _scaled(line("splats", "splats", lambda r: r["ms"]["median"]), 1e6),
        "ns_a_pixel": _scaled(line("pixels", "pixels", lambda r: r["ms"]["median"]), 1e6),
        "ms_a_view": line("views", "views", lambda r: r["ms"]["median"]),
        "gpu_bytes_a_splat": line("splats", "splats", lambda r: r["gpu_bytes"]),
        "gpu_bytes_a_pixel": line("pixels", "pixels", lambda r: r["gpu_bytes"]),
        "process_bytes_a_splat": line("splats", "splats", lambda r: r["process_bytes"]),
        "stages_ns_a_splat": {
            s: _scaled(line("splats", "splats", lambda r, s=s: r["stages_ms"].get(s)), 1e6)  # type: ignore[misc]
            for s in stages
        },
    }


def _scaled(line: dict[str, float] | None, factor: float) -> dict[str, float] | None:
    """With its slope in other units; the constant stays as it is."""
    return None if line is None else {**line, "slope": line["slope"] * factor}


def _too_much(rows: Sequence[dict[str, Any]], splats: int, pixels: int, views: int, grid: Grid) -> str:
    """Why a point is left out: what the point before it took, in proportion, is beyond the budget."""
    measured = [row for row in rows if "ms" in row]
    if len(measured) < len(rows):
        return "larger than one that was left out"
    if not measured:
        return ""
    last = measured[-1]
    factor = max(1.0, splats / last["splats"], views * pixels**2 / last["pixels"])
    seconds = last["ms"]["median"] * factor * (WARM_UP + grid.frames + grid.staged + 1) / 1e3
    if seconds > grid.longest:
        return f"would take about {seconds:.0f} s"
    free, needed = _available(), 3 * factor * last["gpu_bytes"]  # the scene itself and what is made on the way too
    if free is not None and needed > free:
        return f"would need about {needed / 1e9:.1f} GB of memory"
    return ""


def resident() -> int | None:
    """Bytes of memory this process has; None where the system does not tell (only Linux does)."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None


def _available() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable")), None)
