"""Work and precision: time and error of the combinations of settings that a user can choose, and their Pareto front.

The full product is too large. The search draws few frames of a coarse grid of levels, hidden splats and cut-offs, then
of ways that differ in one setting from four of the front, until there are enough; the front is then measured over many
frames, with JPEGs. Settings take turns frame by frame with the default; times are median ratios to the same turn's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any, Literal

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.avatar import splats_of
from glsplat.camera import Camera
from glsplat.config import CULL_PSNR, LEAN, MAX_SIGMA, DebugConfig, RenderConfig, with_fields
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.difference import Difference, pareto, reference_pictures
from glsplat.extras.evaluate.frames import MAX_SHARE, Watch, timed
from glsplat.extras.evaluate.lpips import Lpips
from glsplat.extras.evaluate.metrics import flip
from glsplat.extras.evaluate.subjects import Subject
from glsplat.gl.context import Context
from glsplat.net.codec.encode import encode_picture
from glsplat.net.pace.ladder import SCALES
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose

JPEGS = ((50, "420"), (80, "420"), (90, "420"), (95, "420"), (80, "444"), (95, "444"))
"""Quality and chroma subsampling."""

SERVED = (80, "420")  # JPEG of ``glsplat serve``

VISIBLE_LPIPS, VISIBLE_PSNR = 0.01, 40.0
"""An error is not visible up to this LPIPS (JPEG of quality 80: 0.008); without its weights, from this PSNR in dB."""

FIRST = 28  # the first frame of a series: a multiple of every sort period

COMPARED = 31
"""The frame that is compared with float64: the last before a sort, when a kept order is oldest.

With given cameras it is the frame before: even frames have exactly those cameras.
"""

_BLOCK = 12  # ways that take turns in the search
_NEAR = 1.05  # slowdown against the front up to which a way is a candidate, as the search is short
_MOST = 14  # candidates of the search
_ENOUGH = 40  # ways of the search
_LONGEST = 4  # limit of rounds, while the default differs too much from itself


@dataclass(frozen=True)
class Way:
    """A combination of settings."""

    level: int = 0
    hidden: bool = False  # cull hidden splats
    sigma: float = MAX_SIGMA
    target: Literal["8", "16f", "32f"] = "32f"
    bits: Literal[16, 32] = 32  # of the sort key
    period: int = 1  # frames from sort to sort
    degree: int = 3  # of SH, at most
    scale: float = 1.0  # of the picture's sides; enlarged bicubically
    jpeg: tuple[int, str] | None = None  # quality and chroma; None: not encoded

    @property
    def drawn(self) -> Way:
        """The way without its JPEG."""
        return replace(self, jpeg=None)

    @property
    def method(self) -> str:
        """All settings but the parameters along a curve: level and size, or a JPEG's quality."""
        parts = ["no hidden splats"] if self.hidden else []
        parts += [f"{self.sigma:g} sigma"] if self.sigma != MAX_SIGMA else []
        parts += [f"target {self.target}"] if self.target != "32f" else []
        parts += [f"{self.bits}-bit keys"] if self.bits != 32 else []
        parts += [f"sorted every {self.period}"] if self.period != 1 else []
        parts += [f"SH {self.degree}"] if self.degree != 3 else []
        if self.jpeg:
            parts = [f"JPEG {self.jpeg[1]}", *self.where, *parts]
        return ", ".join(parts) or "all splats"

    @property
    def where(self) -> list[str]:
        """Level and size in words."""
        return ([f"level {self.level}"] if self.level else []) + ([f"{self.scale:g} x"] if self.scale != 1 else [])

    @property
    def words(self) -> str:
        """The settings that differ from the defaults of ``render``."""
        jpeg = [f"q{self.jpeg[0]} {self.jpeg[1]}"] if self.jpeg else []
        rest = self.drawn.method
        return ", ".join([*self.where, *([] if rest == "all splats" else [rest]), *jpeg]) or "default"

    def config(self, base: RenderConfig, output: Literal["float32", "uint8"] = "uint8") -> RenderConfig:
        """Return the renderer's settings; ``base`` has those that a way lacks."""
        own = {"level": self.level, "cull_hidden": self.hidden, "max_sigma": self.sigma, "target": self.target}
        debug = {"sort_bits": self.bits, "sort_period": self.period}
        return with_fields(base, **own, **debug, sh_degree=self.degree, output=output)


def render_words(way: Way, default: Way) -> list[str] | None:
    """Return the options of ``glsplat render`` for ``way``; None if a setting has no option."""
    if replace(way, level=0, hidden=False, target=default.target, degree=default.degree) != default:
        return None
    words = ["--level", str(way.level)] if way.level else []
    words += ["--cull-hidden"] if way.hidden else []
    words += ["--float-target", way.target] if way.target != default.target else []
    return words + (["--sh-degree", str(way.degree)] if way.degree != default.degree else [])


def serve_lines(way: Way, default: Way, auto: bool, size: tuple[int, int]) -> list[str] | None:
    """Return the lines of ``server.toml`` for ``way``; None if a setting has no key.

    ``auto``: culling is on by default at this level. ``size``: full pixels of an eye.
    """
    exact = way.sigma == MAX_SIGMA and not way.level and not way.hidden
    lean = way.sigma == LEAN.max_sigma and (way.hidden or not auto)
    target = default.target if exact else fast_target(default)
    same = Way(way.level, way.hidden, way.sigma, target, degree=default.degree, scale=way.scale, jpeg=way.jpeg)
    if not way.jpeg or way.jpeg[1] != SERVED[1] or not (exact or lean) or way != same:
        return None
    lines = ["exact = true"] if exact else [f"level = {way.level}"]
    lines += ["cull-hidden = true"] if way.hidden and not auto else []
    width, height = (round(side * way.scale) for side in size)
    return [*lines, f"quality = {way.jpeg[0]}", f'size = "{width}x{height}"']


def fast_target(default: Way) -> Literal["8", "16f", "32f"]:
    """Return the target of ``RenderConfig(target="fast")`` on the driver of ``default``."""
    return "8" if default.target == "32f" else default.target


def lpips_if_there() -> Lpips | None:
    """Return LPIPS by AlexNet; None if its weights are missing."""
    try:
        return Lpips("alex")
    except GlsplatError:
        return None


def measure(
    context: Context,
    subject: Subject,
    frames: int,  # of the last round; the search draws a quarter
    lpips: Lpips | None = None,
    seeds: Sequence[Way] = (),  # candidates, which replace the search
    show: Callable[[str], object] = lambda text: None,  # called with the name of each step
) -> dict[str, Any]:
    """Return {"scene", "size", "rows", "searched", "candidates", "quiet", ...} as JSON values.

    Each row has ``ms`` (median of whole frames with 8-bit output, read back; a JPEG: encoded too), ``low`` and ``high``
    (95 % interval), ``cpu_ms`` of the process, ``psnr`` and ``maximum`` of the float picture (a JPEG: decoded) in the
    box that the scene covers, ``flip`` and ``lpips`` of the left view where it is on a front, ``front``, ``marks``.
    """
    study = _Study(context, subject, lpips, show)
    candidates = list(seeds) or study.searched(max(3, frames // 4))
    return study.finished(candidates, frames)


def advice(result: Mapping[str, Any]) -> dict[str, tuple[list[str], dict[str, Any]]]:
    """Return the options to paste for "render" and "serve", with their row and ``visible``.

    The row is the cheapest one whose error is not visible (within 2 % of its time: fewest bytes and options), else the
    most precise one.
    """
    out = {}
    for name in ("render", "serve"):
        rows = [row for row in result["rows"] if row[name] is not None and row["flip"] is not None]
        fine = [
            row
            for row in rows
            if (row["psnr"] >= VISIBLE_PSNR if row["lpips"] is None else row["lpips"] <= VISIBLE_LPIPS)
        ]
        if fine:
            least = 1.02 * min(row["ms"] for row in fine)
            equal = [row for row in fine if row["ms"] <= least]
            row = min(equal, key=lambda row: (row.get("bytes", 0), len(row[name]), row["ms"]))
            out[name] = row[name], row | {"visible": False}
        elif rows:
            row = min(rows, key=lambda row: (row["lpips"] or 0.0, -row["psnr"]))
            out[name] = row[name], row | {"visible": True}
    return out


class _Study:
    """One subject on one context."""

    def __init__(self, context: Context, subject: Subject, lpips: Lpips | None, show: Callable[[str], object]) -> None:
        self._watch, self._context, self._subject, self._show = Watch(), context, subject, show
        self._base, self._splats = base_config(context), splats_of(subject.scene)
        target: Any = self._base.target
        self.default = Way(target=target)
        self._coarsest = len(subject.scene.levels)
        level = self._auto_level()
        lean = [
            Way(n, self._culls(n), LEAN.max_sigma, fast_target(self.default)) for n in range(level, self._coarsest + 1)
        ]
        self._served = lean[0]
        self._adapted = [*lean, *(replace(lean[-1], scale=scale) for scale in SCALES[1:])]
        show("float64")
        self._truth = _Truth(subject, lpips)
        self._errors: dict[Way, dict[str, Any]] = {}
        self._ms: dict[Way, float] = {}  # of the search

    def searched(self, frames: int) -> list[Way]:
        """Return the candidates of a coarse grid and of ways that differ from its front in one setting."""
        self._explore(self._grid(), frames)
        before = 0
        while before < len(self._ms) < _ENOUGH:
            before, front = len(self._ms), _spread(_near(self._ms, self._psnr), 4)
            self._explore((other for way in front for other in self._neighbours(way)), frames)
        near = _near(self._ms, self._psnr, _NEAR)
        exact = _near({w: ms for w, ms in self._ms.items() if render_words(w, self.default) is not None}, self._psnr)
        lean = _near({w: ms for w, ms in self._ms.items() if self._lines(replace(w, jpeg=SERVED))}, self._psnr)
        return list(dict.fromkeys([*_spread(near, _MOST), *exact, *lean]))

    def finished(self, candidates: Sequence[Way], frames: int) -> dict[str, Any]:
        """Return the result: candidates and defaults over many frames, with JPEGs."""
        jpegs: dict[Way, Sequence[tuple[int, str]]]
        jpegs = {way: JPEGS for way in [*_spread(candidates, 6), self._served]}
        for way in [w for w in candidates if self._lines(replace(w, jpeg=SERVED))]:
            jpegs[way] = JPEGS
        ways = list(dict.fromkeys([self.default, *candidates, *self._adapted]))
        jpegs |= {way: (SERVED,) for way in [self.default, *self._adapted] if way not in jpegs}
        self._show(f"{len(ways)} ways")
        turns = _Turns(self._context, self._subject, self._base, ways, self.default, jpegs)
        with turns:
            for _ in range(_LONGEST):
                turns.run(frames)
                noise = turns.noise()
                if noise <= MAX_SHARE:
                    break
        for way in ways:
            self._compare(way)
        rows = [self._row(way, turns.times(way)) for way in ways]
        for way, several in jpegs.items():
            for jpeg in several:
                sent, sizes = turns.sent(way, jpeg)
                one = replace(way, jpeg=jpeg)
                self._errors[one] = self._truth.error(sent, opaque=True)
                rows.append(self._row(one, turns.times(way, jpeg)) | {"bytes": sizes})
        self._show("FLIP and LPIPS")
        self._judge(rows, {way: turns.kept[way] for way in ways})
        width, height = (self._subject.views(0)[0].width, self._subject.views(0)[0].height)
        return {
            "scene": self._subject.name,
            "splats": len(self._splats),
            "views": len(self._subject.views(0)),
            "size": [width, height],
            "frames": turns.frames,
            "dense_truth": self._subject.right is not None,
            "rows": rows,
            "searched": [{"words": w.words, "ms": round(ms, 3), **self._errors[w]} for w, ms in self._ms.items()],
            "quiet": asdict(self._watch.read(noise)),
            "candidates": [asdict(way) for way in candidates],
        }

    def _grid(self) -> Iterable[Way]:
        hidden = (False, True) if self._splats.cones is not None else (False,)
        for level, culled, sigma in product(range(self._coarsest + 1), hidden, (MAX_SIGMA, LEAN.max_sigma)):
            yield replace(self.default, level=level, hidden=culled, sigma=sigma)

    def _neighbours(self, way: Way) -> Iterable[Way]:
        axes: dict[str, Sequence[Any]] = {
            "sigma": (2.0, 3.0),
            "target": ("8", "16f", "32f"),
            "bits": (16, 32),
            "period": () if self._subject.cameras else (2, 4),  # given cameras do not move
            "degree": range(self._splats.sh_degree),
            "scale": (0.75, 0.5),
        }
        for axis, values in axes.items():
            for value in values:
                changed: dict[str, Any] = {axis: value}
                yield replace(way, **changed)

    def _explore(self, ways: Iterable[Way], frames: int) -> None:
        new = [way for way in dict.fromkeys(ways) if way not in self._ms]
        for at in range(0, len(new), _BLOCK):
            block = new[at : at + _BLOCK]
            self._show(f"search, {len(self._ms)} ways")
            with _Turns(self._context, self._subject, self._base, block, self.default, {}, "float32") as turns:
                turns.run(frames)
            for way in block:
                self._ms[way] = turns.times(way)["ms"]
                self._errors[way] = self._truth.error(turns.kept[way])

    def _compare(self, way: Way) -> None:
        if way not in self._errors:
            self._errors[way] = self._truth.error(_float_picture(self._context, self._subject, self._base, way))

    def _psnr(self, way: Way) -> float:
        return float(self._errors[way]["psnr"])

    def _auto_level(self) -> int:
        if not self._coarsest:
            return 0
        config = replace(self._base, level="auto")
        with _renderer(self._context, self._subject, config, 1.0) as renderer:
            renderer.render(*_shot(self._subject, _compared(self._subject), renderer))
            return int(renderer.stats.levels[0])

    def _culls(self, level: int) -> bool:
        """Return whether ``cull_hidden="auto"`` culls at this level."""
        splats = splats_of(self._subject.scene.levels[level - 1].content) if level else self._splats
        return splats.cones is not None and (splats.cones_psnr or 0.0) >= CULL_PSNR

    def _lines(self, way: Way) -> list[str] | None:
        view = self._subject.views(0)[0]
        return serve_lines(way, self.default, self._culls(way.level), (view.width, view.height))

    def _row(self, way: Way, times: dict[str, float]) -> dict[str, Any]:
        marks = ["render"] if way == self.default else []
        if way.jpeg in (None, SERVED):
            marks += ["serve"] if way.drawn == self._served else []
            marks += ["--fps"] if way.drawn in self._adapted[1:] else []
        exact, lines = render_words(way, self.default), self._lines(way)
        row = {"words": way.words, "method": way.method, "way": asdict(way), **times, **self._errors[way]}
        return row | {"flip": None, "lpips": None, "marks": marks, "front": False, "render": exact, "serve": lines}

    def _judge(self, rows: Sequence[dict[str, Any]], pictures: Mapping[Way, NDArray[Any]]) -> None:
        """Add ``front`` to rows; add FLIP and LPIPS to rows on a front, on that of pasteable options, or with marks."""
        drawn, sent = ([r for r in rows if (r["way"]["jpeg"] is None) == plain] for plain in (True, False))
        chosen: dict[int, dict[str, Any]] = {}
        for group in (drawn, sent, [r for r in rows if r["render"] is not None], [r for r in rows if r["serve"]]):
            front = [group[i] for i in pareto([(r["ms"], r["psnr"]) for r in group])]
            for row in front:
                row["front"] = row["front"] or group is drawn or group is sent
            chosen |= {id(row): row for row in front}
        chosen |= {id(row): row for row in rows if "render" in row["marks"] or "serve" in row["marks"]}
        for row in chosen.values():
            way = Way(**row["way"])
            picture = pictures[way.drawn] if way.jpeg is None else through_jpeg(pictures[way.drawn], *way.jpeg)
            row |= self._truth.seen(picture)


def base_config(context: Context) -> RenderConfig:
    """Return the driver's defaults with every "auto" resolved, so that equal settings are measured once."""
    if not context.software:
        return RenderConfig(target="16f", debug=DebugConfig(shape="quad", fetch="attributes"))
    fetch: Literal["storage", "attributes"] = "storage" if context.vertex_storage else "attributes"
    return RenderConfig(target="32f", sorter="cpu", debug=DebugConfig(shape="triangle", fetch=fetch))


def _near(ms: Mapping[Way, float], psnr: Callable[[Way], float], factor: float = 1.0) -> list[Way]:
    """Return the ways, fastest first, unless another is faster by more than ``factor`` at no less PSNR."""
    order = sorted(ms, key=lambda way: ms[way])
    front = [order[i] for i in pareto([(ms[way], psnr(way)) for way in order])]
    if factor == 1:
        return front
    return [way for way in order if not any(ms[f] * factor < ms[way] and psnr(f) >= psnr(way) for f in front)]


def _spread(ways: Sequence[Way], most: int) -> list[Way]:
    """Return at most ``most`` of ``ways``, evenly spaced, with the first and the last."""
    return [
        ways[i] for i in sorted({*np.linspace(0, len(ways) - 1, min(most, len(ways))).round().astype(int).tolist()})
    ]


class _Truth:
    """The float64 picture of the compared frame; measures errors in the box that it covers."""

    def __init__(self, subject: Subject, lpips: Lpips | None) -> None:
        scene = subject.right or subject.scene
        frame = _compared(subject)
        self._expected = reference_pictures(scene, subject.views(frame), subject.pose(frame))
        covered = self._expected[..., 3].max(axis=0) > 1 / 255
        rows, columns = np.flatnonzero(covered.any(axis=1)), np.flatnonzero(covered.any(axis=0))
        whole = (slice(None), slice(None))
        box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)) if len(rows) else whole
        self._box = (slice(None), *box)
        self._left = np.clip(self._expected[self._box][0, ..., :3], 0, 1)
        self._lpips = lpips if min(self._left.shape[:2]) >= 31 else None  # pixels that LPIPS needs
        self._features = None if self._lpips is None else self._lpips.features(self._left)

    def error(self, picture: NDArray[Any], opaque: bool = False) -> dict[str, Any]:
        """Return PSNR over RGB of both views and the largest error; ``opaque``: alpha is not compared."""
        image, expected = self._boxed(picture), self._expected[self._box]
        channels = slice(3 if opaque else 4)
        found = Difference.of(image[..., channels], expected[..., channels], flip=False)
        return {"psnr": round(found.psnr, 2), "maximum": round(found.maximum, 5)}

    def seen(self, picture: NDArray[Any]) -> dict[str, float | None]:
        """Return FLIP and LPIPS of the left view."""
        left = np.clip(self._boxed(picture)[0, ..., :3], 0, 1)
        lpips = None
        if self._lpips is not None and self._features is not None:
            lpips = round(self._lpips.distance(self._lpips.features(left), self._features), 5)
        return {"flip": round(flip(left, self._left), 5), "lpips": lpips}

    def _boxed(self, picture: NDArray[Any]) -> NDArray[np.float64]:
        height, width = self._expected.shape[1:3]
        if picture.shape[1:3] != (height, width):
            picture = np.stack([cv2.resize(p, (width, height), interpolation=cv2.INTER_CUBIC) for p in picture])
        out: NDArray[np.float64] = picture[self._box] / (255.0 if picture.dtype == np.uint8 else 1.0)
        return out


class _Turns:
    """Renderers of several ways, with the default twice, that take turns on the same frames."""

    def __init__(
        self,
        context: Context,
        subject: Subject,
        base: RenderConfig,
        ways: Sequence[Way],
        default: Way,
        jpegs: Mapping[Way, Sequence[tuple[int, str]]],
        output: Literal["float32", "uint8"] = "uint8",
    ) -> None:
        self._ways = ["default", "once more", *ways]
        self._subject, self._jpegs, self._frame = subject, jpegs, FIRST
        self._shuffle = np.random.default_rng(0)  # caches are colder after an expensive way
        self._times: dict[Any, list[tuple[float, float]]] = {}  # by way, or way and JPEG: ms of wall and of CPU
        self._bytes: dict[tuple[Way, tuple[int, str]], int] = {}
        self.kept: dict[Any, NDArray[Any]] = {}  # pictures of the compared frame
        with ExitStack() as stack:
            self._renderers = {
                way: stack.enter_context(_renderer(context, subject, one.config(base, output), one.scale))
                for way, one in zip(self._ways, [default, default, *ways], strict=True)
            }
            self._stack = stack.pop_all()

    def __enter__(self) -> _Turns:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def run(self, frames: int) -> None:
        """Draw ``frames`` more frames; the first four of all, up to the compared one, are warm-up."""
        for frame in range(self._frame, max(self._frame, COMPARED + 1) + frames):
            for index in self._shuffle.permutation(len(self._ways)):
                way = self._ways[index]
                renderer = self._renderers[way]
                views, pose = _shot(self._subject, frame, renderer)
                taken, picture = timed(lambda: renderer.render(views, pose))  # noqa: B023 - called at once
                if frame == _compared(self._subject):
                    self.kept[way] = picture
                if frame > COMPARED:
                    self._times.setdefault(way, []).append(taken)
                for jpeg in self._jpegs.get(way, ()) if isinstance(way, Way) else ():
                    more, data = timed(lambda: [encode_picture(p, *jpeg) for p in picture])  # noqa: B023
                    self._bytes[way, jpeg] = sum(map(len, data))
                    if frame > COMPARED:
                        both = (taken[0] + more[0], taken[1] + more[1])
                        self._times.setdefault((way, jpeg), []).append(both)
        self._frame = frame + 1

    @property
    def frames(self) -> int:
        """Measured frames."""
        return len(self._times["default"])

    def noise(self) -> float:
        """Return the relative difference between the medians of the default and of its copy."""
        return abs(_ratios(self._times["once more"], self._times["default"])[1] - 1)

    def times(self, way: Way, jpeg: tuple[int, str] | None = None) -> dict[str, float]:
        """Return ``ms``, ``low``, ``high`` and ``cpu_ms``."""
        base = self._times["default"]
        low, ratio, high = _ratios(self._times[way if jpeg is None else (way, jpeg)], base, way.period)
        whole = float(np.median([wall for wall, _ in base]))
        cpu = _ratios([t[::-1] for t in self._times[way if jpeg is None else (way, jpeg)]],
                      [t[::-1] for t in base], way.period)[1] * float(np.median([c for _, c in base]))  # fmt: skip
        values = {"ms": ratio * whole, "low": low * whole, "high": high * whole, "cpu_ms": cpu}
        return {name: round(value, 3) for name, value in values.items()}

    def sent(self, way: Way, jpeg: tuple[int, str]) -> tuple[NDArray[np.uint8], int]:
        """Return the compared picture as a client decodes it, and the bytes of the last frame."""
        return through_jpeg(self.kept[way], *jpeg), self._bytes[way, jpeg]


def _ratios(
    times: Sequence[tuple[float, float]], base: Sequence[tuple[float, float]], period: int = 1
) -> tuple[float, float, float]:
    """Return (low, median, high): the median ratio to the default of the same turns, and its 95 % interval.

    Ratios are of sums of ``period`` turns, the cycle of a way that sorts every ``period`` frames.
    """
    count = len(times) // period or 1
    own, other = (np.array([t[0] for t in series])[: count * period] for series in (times, base))
    parts = np.array_split(own, count), np.array_split(other, count)
    ratios = np.sort([a.sum() / max(b.sum(), 1e-9) for a, b in zip(*parts, strict=True)])
    rank = max(0, int(len(ratios) / 2 - 0.98 * np.sqrt(len(ratios))))  # of order statistics, by the normal distribution
    return float(ratios[rank]), float(np.median(ratios)), float(ratios[-1 - rank])


def _renderer(context: Context, subject: Subject, config: RenderConfig, scale: float) -> Renderer:
    views = subject.views(0)
    size = max(1, round(views[0].width * scale)), max(1, round(views[0].height * scale))
    return Renderer(subject.scene, size=size, views=len(views), config=config, context=context)


def _compared(subject: Subject) -> int:
    return COMPARED - bool(subject.cameras)


def _shot(subject: Subject, frame: int, renderer: Renderer) -> tuple[list[Camera], Pose | None]:
    """Return views and pose of a frame, at the renderer's size."""
    return [view.resized(*renderer.size) for view in subject.views(frame)], subject.pose(frame)


def _float_picture(context: Context, subject: Subject, base: RenderConfig, way: Way) -> NDArray[Any]:
    """Return the compared frame as floats; for a way that keeps an order, draw the frames before it, too."""
    last = _compared(subject)
    with _renderer(context, subject, way.config(base, "float32"), way.scale) as renderer:
        for frame in range(FIRST if way.period > 1 else last, last + 1):
            picture = renderer.render(*_shot(subject, frame, renderer))
    return picture


def through_jpeg(pictures: NDArray[Any], quality: int, chroma: str) -> NDArray[np.uint8]:
    """Return pictures [V, H, W, 3] as a client decodes them."""
    return np.stack([simplejpeg.decode_jpeg(encode_picture(image, quality, chroma), "RGB") for image in pictures])
