"""Error against run time of one scene: its settings take turns frame by frame in one process, against float64."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.avatar import splats_of
from glsplat.camera import Camera
from glsplat.extras.evaluate.difference import Difference, ReferencePictures, pareto
from glsplat.extras.evaluate.frames import WARM_UP, Series
from glsplat.extras.evaluate.knobs import Drawn, Setting
from glsplat.extras.evaluate.subjects import Subject
from glsplat.gl.context import Context
from glsplat.net.codec.encode import encode_picture
from glsplat.renderer import Renderer

__all__ = ["better_than_default", "measure"]


def measure(
    context: Context,
    subject: Subject,
    settings: Sequence[Setting],
    frames: int,
    compared: Sequence[int] = (WARM_UP,),  # frames whose pictures are held against float64
    truth: ReferencePictures | None = None,  # what is right; default: the subject's own in float64
) -> dict[str, Any]:
    """One row a setting: ms a frame (8-bit output, read back; JPEG: encoded too) and the error of the float picture.

    The error of the order knob is against float64 in an exact order an eye; every other against the contract. A setting
    that sorts every n-th frame has the mean over the medians of those n.
    """
    truth = truth or ReferencePictures(subject.right or subject.scene)
    drawn = list({s.drawn: None for s in settings})
    times, encodes, seen = _timed(context, subject, settings, drawn, frames, compared[0])
    for order in sorted({_order(s) for s in settings}):
        for frame in compared:
            truth.of(subject.views(frame), subject.pose(frame), order)
    errors: dict[tuple[Drawn, str], Difference] = {}
    for one in drawn:
        if one.copy:
            continue
        pictures = _exact(context, subject, one, compared)
        for order in sorted({_order(s) for s in settings if s.drawn == one}):
            errors[one, order] = _error(subject, truth, pictures, compared, order)
    rows = []
    for s in settings:
        series = times[s.drawn]
        row: dict[str, Any] = {"knob": s.knob, "setting": s.label}
        if s.jpeg:
            series = [a + b for a, b in zip(series, encodes[s.jpeg][0], strict=True)]
            sent = np.stack([_through_jpeg(image, *s.jpeg) for image in seen[s.drawn]])
            frame = compared[0]
            wanted = truth.of(subject.views(frame), subject.pose(frame), "shared").copy()
            wanted[..., 3] = 1.0  # a JPEG has no alpha: it is not compared
            error = Difference.of(sent, wanted)
            row |= {"encode_ms": asdict(Series.of(encodes[s.jpeg][0])), "bytes": int(np.median(encodes[s.jpeg][1]))}
        else:
            error = errors[replace(s.drawn, copy=0), _order(s)]
        period = s.drawn.config.debug.sort_period
        ms = {**asdict(Series.of(series)), "median": round(_typical(series, period), 3)}
        row |= {"ms": ms, **asdict(error)}
        rows.append(row)
    for row in rows:  # of the medians as they are shown, so that a reader finds it again
        row["ratio"] = round(row["ms"]["median"] / rows[0]["ms"]["median"], 3)
    _mark(rows, settings)
    noise = abs(float(np.median(times[settings[0].drawn])) - float(np.median(times[settings[1].drawn])))
    width, height = _size(subject, 1.0)
    return {
        "scene": subject.name,
        "splats": len(splats_of(subject.scene)),
        "views": len(subject.views(0)),
        "size": [width, height],
        "frames": frames,
        "error_frames": list(compared),
        "dense_truth": subject.right is not None,
        "noise_ms": round(noise, 3),
        "settings": rows,
        "better": better_than_default(rows, noise),
    }


def better_than_default(rows: Sequence[dict[str, Any]], noise: float) -> list[str]:
    """Settings that are closer or as close, and faster by more than ``noise`` (ms): candidates for a default."""
    out = []
    for row in rows:
        default = next((r for r in rows if r["default"] and r["truth"] == row["truth"]), None)
        if default and row["psnr"] >= default["psnr"] and row["ms"]["median"] < default["ms"]["median"] - noise:
            out.append(f"{row['knob']}: {row['setting']}")
    return [name for name in out if not name.startswith("default")]


def _mark(rows: Sequence[dict[str, Any]], settings: Sequence[Setting]) -> None:
    """Add ``truth``, ``default`` and ``pareto``; a front holds what was compared with one truth."""
    base = settings[0]
    for row, setting in zip(rows, settings, strict=True):
        row["truth"] = _order(setting)
        row["default"] = setting.drawn == base.drawn and setting.jpeg is None
    for order in ("shared", "per_view"):
        group = [(row, s) for row, s in zip(rows, settings, strict=True) if row["truth"] == order]
        once = [(row, s) for row, s in group if not s.drawn.copy]  # the default does not compete with itself
        front = pareto([(row["ms"]["median"], row["psnr"]) for row, _ in once])
        unbeaten = {(once[i][1].drawn, once[i][1].jpeg) for i in front}
        for row, setting in group:
            row["pareto"] = (setting.drawn, setting.jpeg) in unbeaten


def _order(setting: Setting) -> str:
    """Which float64 pictures a setting is held against."""
    return "per_view" if setting.knob == "order" else "shared"


def _timed(
    context: Context,
    subject: Subject,
    settings: Sequence[Setting],
    drawn: Sequence[Drawn],
    frames: int,
    kept: int,  # the frame whose pictures are kept
) -> tuple[dict[Drawn, list[float]], dict[tuple[int, str], tuple[list[float], list[int]]], dict[Drawn, NDArray[Any]]]:
    """Whole frames of every setting, one frame of each after the other, in another order each time."""
    shuffle = np.random.default_rng(0)  # whoever follows an expensive setting finds colder caches
    renderers: dict[Drawn, Renderer] = {}
    times: dict[Drawn, list[float]] = {one: [] for one in drawn}
    jpegs = {s.jpeg: s.drawn for s in settings if s.jpeg}
    encodes: dict[tuple[int, str], tuple[list[float], list[int]]] = {jpeg: ([], []) for jpeg in jpegs}
    seen: dict[Drawn, NDArray[Any]] = {}
    try:
        for one in drawn:
            renderers[one] = _renderer(context, subject, one, "uint8")
        for frame in range(WARM_UP + frames):
            views, pose = subject.views(frame), subject.pose(frame)
            latest = {}
            for one in (drawn[i] for i in shuffle.permutation(len(drawn))):
                picture = renderers[one].render(_scaled(views, one.scale), pose)
                latest[one] = picture
                if frame == kept:
                    seen[one] = picture
                if frame >= WARM_UP:
                    times[one].append(renderers[one].timings["total"])
            for jpeg, one in jpegs.items():
                ms, size = _encode(latest[one], *jpeg)
                if frame >= WARM_UP:
                    encodes[jpeg][0].append(ms)
                    encodes[jpeg][1].append(size)
    finally:
        for renderer in renderers.values():
            renderer.release()
    return times, encodes, seen


def _renderer(context: Context, subject: Subject, drawn: Drawn, output: str) -> Renderer:
    config = replace(drawn.config, output=output)  # type: ignore[arg-type]
    return Renderer(subject.level(drawn.level), size=_size(subject, drawn.scale), config=config, context=context)


def _exact(context: Context, subject: Subject, drawn: Drawn, frames: Sequence[int]) -> list[NDArray[Any]]:
    """Float pictures of ``frames``; what remembers is shown every frame up to them."""
    pictures = []
    with _renderer(context, subject, drawn, "float32") as renderer:
        for frame in range(max(frames) + 1) if drawn.remembers else frames:
            picture = renderer.render(_scaled(subject.views(frame), drawn.scale), subject.pose(frame))
            if frame in frames:
                pictures.append(picture)
    return pictures


def _error(
    subject: Subject, truth: ReferencePictures, pictures: Sequence[NDArray[Any]], frames: Sequence[int], order: str
) -> Difference:
    several = []
    for picture, frame in zip(pictures, frames, strict=True):
        expected = truth.of(subject.views(frame), subject.pose(frame), order)
        height, width = expected.shape[1:3]
        if picture.shape != expected.shape:
            picture = np.stack([cv2.resize(p, (width, height), interpolation=cv2.INTER_CUBIC) for p in picture])
        several.append(Difference.of(picture, expected))
    return Difference.worst(several)


def _typical(values: Sequence[float] | NDArray[np.float64], period: int) -> float:
    """The median; of what repeats itself every ``period`` samples the mean over the medians of its phases."""
    return float(np.mean([np.median(values[i::period]) for i in range(min(period, len(values)))]))


def _encode(picture: NDArray[Any], quality: int, chroma: str) -> tuple[float, int]:
    """Milliseconds and bytes of all views, one after the other on this thread."""
    start = time.perf_counter()
    data = [encode_picture(image, quality, chroma) for image in picture]
    return (time.perf_counter() - start) * 1e3, sum(map(len, data))


def _through_jpeg(image: NDArray[Any], quality: int, chroma: str) -> NDArray[np.uint8]:
    """[H, W, 4] as the client sees it, alpha 255."""
    rgb = simplejpeg.decode_jpeg(encode_picture(image, quality, chroma), "RGB")
    return np.concatenate([rgb, np.full((*rgb.shape[:2], 1), 255, np.uint8)], axis=-1)


def _size(subject: Subject, scale: float) -> tuple[int, int]:
    view = subject.views(0)[0]
    return max(1, round(view.width * scale)), max(1, round(view.height * scale))


def _scaled(views: list[Camera], scale: float) -> list[Camera]:
    if scale == 1.0:
        return views
    return [v.resized(max(1, round(v.width * scale)), max(1, round(v.height * scale))) for v in views]
