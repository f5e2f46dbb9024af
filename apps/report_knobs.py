"""Error against run time: every knob's settings on one scene, interleaved frame by frame in one process."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.context import Context
from glsplat.errors import GlsplatError
from glsplat.net.encode import encode_picture
from glsplat.renderer import Renderer
from glsplat.skinning.motion import Motion, load_motion
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats

from .bench import FOV, WARM_UP, Series
from .report_error import Difference, Truth, pareto
from .scene import splats_of, view_of, viewing_point

__all__ = ["Setting", "Subject", "base_config", "better_than_default", "measure", "settings_of", "steps"]

Tick = Callable[[int], object]
"""Told how many steps were done: a frame is one, an error in float64 is ERROR_STEPS."""

ERROR_STEPS = 20

Key = tuple[RenderConfig, float, int]

NUDGE = 1e-6
"""Radians a still camera turns a frame: nothing one can see, but every frame is sorted."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A scene, who looks at it, and how it moves."""

    name: str
    scene: Splats | Avatar
    size: int  # pixels a side of each view; the longer side of a given camera
    moving: bool = False
    cameras: tuple[Camera, ...] = ()  # fixed ones; none: a pair that orbits a degree a frame

    def views(self, frame: int) -> list[Camera]:
        """The views of a frame."""
        if self.cameras:
            cosine, sine = np.cos(NUDGE * frame), np.sin(NUDGE * frame)
            turn = np.array([[cosine, 0, sine, 0], [0, 1, 0, 0], [-sine, 0, cosine, 0], [0, 0, 0, 1.0]])
            return [replace(camera, viewmat=turn @ camera.viewmat) for camera in self.cameras]
        eye, target = viewing_point(self.scene, FOV)
        x, y, z = eye - target
        angle = np.radians(frame)
        turned = np.array([x * np.cos(angle) + z * np.sin(angle), y, z * np.cos(angle) - x * np.sin(angle)])
        return view_of(target + turned, target, (self.size, self.size), FOV, ipd=0.055)

    def pose(self, frame: int) -> Pose | None:
        """The pose of a frame: the embedded wave-and-turn, or on a rig that has no such joints a sway of all."""
        if not isinstance(self.scene, Avatar) or not self.moving:
            return None
        skeleton = self.scene.skeleton
        motion = _motion(skeleton)
        if motion is None:
            return Pose(np.full((len(skeleton), 3), 0.3 * np.sin(0.1 * frame)), np.zeros(3))
        return motion.at(frame / 30)


@lru_cache(maxsize=4)
def _motion(skeleton: Skeleton) -> Motion | None:
    try:
        return load_motion("wave-and-turn", skeleton)
    except GlsplatError:
        return None


@dataclass(frozen=True)
class Setting:
    """One choice of one knob."""

    knob: str
    label: str
    config: RenderConfig
    scale: float = 1.0  # of the pixels a side; drawn so and enlarged to the reference's size
    jpeg: tuple[int, str] | None = None  # quality and chroma subsampling of the picture sent
    copy: int = 0  # measured once more by a renderer of its own: what the clock alone makes different

    @property
    def key(self) -> Key:
        """Settings of one key are one measurement."""
        return self.config, self.scale, self.copy


def base_config(context: Context) -> RenderConfig:
    """The defaults of this driver with nothing left to "auto", so that equal settings are measured once."""
    target, shape = ("32f", "triangle") if context.software else ("16f", "quad")
    return RenderConfig(target=target, shape=shape)  # type: ignore[arg-type]


def settings_of(subject: Subject, base: RenderConfig) -> list[Setting]:
    """The grid of a scene: one knob at a time away from the defaults; what a scene does not have is left out."""
    out = [Setting("default", "default", base), Setting("default", "once more", base, copy=1)]

    def add(knob: str, values: Sequence[Any], **names: Any) -> None:
        out.extend(Setting(knob, str(value), replace(base, **{names["field"]: value})) for value in values)

    add("target format", ("8", "16f", "32f"), field="target")
    add("sort bits", (16, 32), field="sort_bits")
    add("shape", ("quad", "triangle"), field="shape")
    add("extent cut-off (sigma)", (2.0, 2.5, 3.0, 3.33), field="max_sigma")
    if len(subject.views(0)) == 2:
        add("order", ("shared", "per_view"), field="order")
    if isinstance(subject.scene, Avatar):
        joints = subject.scene.skin.influences
        add("influences", [k for k in (1, 2, 4, 8) if k < joints], field="influences")
        out.append(Setting("influences", f"all ({joints})", base))
        add("rotation", ("polar", "raw"), field="rotation")
    degree = splats_of(subject.scene).sh_degree
    if degree:
        out += [Setting("SH degree", str(d), replace(base, sh_degree=d) if d < degree else base) for d in range(degree)]
        out.append(Setting("SH degree", str(degree), base))
    out += [Setting("resolution", f"{scale:g} x", base, scale=scale) for scale in (0.5, 0.75, 1.0)]
    jpegs = [(50, "420"), (80, "420"), (90, "420"), (95, "420"), (80, "444"), (95, "444")]
    out += [Setting("JPEG", f"q{quality} {chroma}", base, jpeg=(quality, chroma)) for quality, chroma in jpegs]
    return out


def steps(settings: Sequence[Setting], frames: int) -> int:
    """How many steps ``measure`` will tell of."""
    drawn = {s.key for s in settings}
    errors = {(s.key, _order(s)) for s in settings if not s.copy}
    return len(drawn) * (WARM_UP + frames) + ERROR_STEPS * len(errors)


def measure(
    context: Context,
    subject: Subject,
    settings: Sequence[Setting],
    frames: int,
    error_frames: Sequence[int] = (WARM_UP,),
    truth: Truth | None = None,  # what is right; default: the subject itself in float64
    tick: Tick = lambda _: None,
) -> dict[str, Any]:
    """One row a setting: ms a frame (8-bit output, read back; JPEG: encoded too) and the error of the float picture.

    The error of the order knob is against float64 in an exact order an eye; every other against the contract.
    """
    truth = truth or Truth(subject.scene)
    drawn = list({s.key: None for s in settings})
    times, encodes, seen = _timed(context, subject, settings, drawn, frames, error_frames[0], tick)
    errors: dict[tuple[Key, str], Difference] = {}
    for key in drawn:
        config, scale, copy = key
        if copy:
            continue
        orders = {_order(s) for s in settings if s.key == key}
        with Renderer(
            subject.scene, size=_size(subject, scale), config=replace(config, output="float32"), context=context
        ) as exact:
            pictures = [exact.render(_scaled(subject.views(f), scale), subject.pose(f)) for f in error_frames]
        for order in orders:
            errors[key, order] = _error(subject, truth, pictures, error_frames, order)
            tick(ERROR_STEPS)
    rows = []
    for s in settings:
        series = times[s.key]
        row: dict[str, Any] = {"knob": s.knob, "setting": s.label}
        if s.jpeg:
            series = [a + b for a, b in zip(series, encodes[s.jpeg][0], strict=True)]
            sent = np.stack([_through_jpeg(image, *s.jpeg) for image in seen[s.key]])
            frame = error_frames[0]
            wanted = truth.of(subject.views(frame), subject.pose(frame), "shared").copy()
            wanted[..., 3] = 1.0  # a JPEG has no alpha: it is not compared
            error = Difference.of(sent, wanted)
            row |= {"encode_ms": asdict(Series.of(encodes[s.jpeg][0])), "bytes": int(np.median(encodes[s.jpeg][1]))}
        else:
            error = errors[(s.config, s.scale, 0), _order(s)]
        row |= {"ms": asdict(Series.of(series)), **asdict(error)}
        rows.append(row)
    _mark(rows, settings)
    noise = abs(float(np.median(times[settings[0].key])) - float(np.median(times[settings[1].key])))
    width, height = _size(subject, 1.0)
    return {
        "scene": subject.name,
        "splats": len(splats_of(subject.scene)),
        "views": len(subject.views(0)),
        "size": [width, height],
        "frames": frames,
        "error_frames": list(error_frames),
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
        row["default"] = setting.key == base.key and setting.jpeg is None
    for order in ("shared", "per_view"):
        group = [(row, s) for row, s in zip(rows, settings, strict=True) if row["truth"] == order]
        front = pareto([(row["ms"]["median"], row["psnr"]) for row, _ in group])
        unbeaten = {(group[i][1].key, group[i][1].jpeg) for i in front}
        for row, setting in group:
            row["pareto"] = (setting.key, setting.jpeg) in unbeaten


def _order(setting: Setting) -> str:
    """Which float64 pictures a setting is held against."""
    return "per_view" if setting.knob == "order" else "shared"


def _timed(
    context: Context,
    subject: Subject,
    settings: Sequence[Setting],
    drawn: Sequence[Key],
    frames: int,
    kept: int,  # the frame whose pictures are kept
    tick: Tick,
) -> tuple[dict[Key, list[float]], dict[tuple[int, str], tuple[list[float], list[int]]], dict[Key, NDArray[Any]]]:
    """Whole frames of every setting, one frame of each after the other, in another order each time."""
    shuffle = np.random.default_rng(0)  # whoever follows an expensive setting finds colder caches
    renderers = {
        key: Renderer(
            subject.scene, size=_size(subject, key[1]), config=replace(key[0], output="uint8"), context=context
        )
        for key in drawn
    }
    times: dict[Key, list[float]] = {key: [] for key in drawn}
    jpegs = {s.jpeg: s.key for s in settings if s.jpeg}
    encodes: dict[tuple[int, str], tuple[list[float], list[int]]] = {jpeg: ([], []) for jpeg in jpegs}
    seen: dict[Key, NDArray[Any]] = {}
    try:
        for frame in range(WARM_UP + frames):
            pose = subject.pose(frame)
            latest = {}
            for key in (drawn[i] for i in shuffle.permutation(len(drawn))):
                picture = renderers[key].render(_scaled(subject.views(frame), key[1]), pose)
                latest[key] = picture
                if frame == kept:
                    seen[key] = picture
                if frame >= WARM_UP:
                    times[key].append(renderers[key].timings["total"])
                tick(1)
            for jpeg, key in jpegs.items():
                ms, size = _encode(latest[key], *jpeg)
                if frame >= WARM_UP:
                    encodes[jpeg][0].append(ms)
                    encodes[jpeg][1].append(size)
    finally:
        for renderer in renderers.values():
            renderer.release()
    return times, encodes, seen


def _error(
    subject: Subject, truth: Truth, pictures: Sequence[NDArray[Any]], frames: Sequence[int], order: str
) -> Difference:
    several = []
    for picture, frame in zip(pictures, frames, strict=True):
        expected = truth.of(subject.views(frame), subject.pose(frame), order)
        height, width = expected.shape[1:3]
        if picture.shape != expected.shape:
            picture = np.stack([cv2.resize(p, (width, height), interpolation=cv2.INTER_CUBIC) for p in picture])
        several.append(Difference.of(picture, expected))
    return Difference.worst(several)


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
