"""The grid of a report: every knob that has a price in error, one at a time away from the defaults of a driver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from glsplat.avatar import Avatar, splats_of
from glsplat.config import DebugConfig, RenderConfig, with_fields
from glsplat.extras.evaluate.frames import WARM_UP
from glsplat.extras.evaluate.subjects import Subject
from glsplat.gl.context import Context

__all__ = ["CONFIG_KNOBS", "LONGEST_PERIOD", "Drawn", "Setting", "base_config", "error_frames", "settings_of"]

CONFIG_KNOBS: tuple[tuple[str, str, tuple[Any, ...]], ...] = (
    ("target format", "target", ("8", "16f", "32f")),
    ("sort bits", "sort_bits", (16, 32)),
    ("sorter", "sorter", ("cpu", "gpu")),
    ("re-sort period", "sort_period", (1, 2, 4, 8)),
    ("shape", "shape", ("quad", "triangle")),
    ("extent cut-off (sigma)", "max_sigma", (2.0, 2.5, 3.0, 3.33)),
    ("records fetched", "fetch", ("attributes", "storage")),
    ("order", "order", ("shared", "per_view")),
    ("rotation", "rotation", ("polar", "raw")),
)
"""Knobs that are one field of RenderConfig or DebugConfig: name, field, values. Scenes leave out useless knobs."""

LONGEST_PERIOD = 8
"""Frames after which every re-sort period of the grid has sorted again."""

LEVELS = (0.125, 0.25, 0.5, 1.0)
"""Shares of the splats that are kept."""

CULL_MARGINS = (-0.1, 0.0, 0.1, 0.2)
"""Added to the smallest cosine of visibility cones: more leaves out more."""

FEWEST = 1000
"""Splats of a scene that is worth levels of detail."""

JPEGS = ((50, "420"), (80, "420"), (90, "420"), (95, "420"), (80, "444"), (95, "444"))
"""Quality and chroma subsampling."""


@dataclass(frozen=True)
class Drawn:
    """What one renderer does; settings that need the same are one measurement."""

    config: RenderConfig
    scale: float = 1.0  # of the pixels a side; drawn so and enlarged to the reference's size
    level: float = 1.0  # share of the splats
    copy: int = 0  # measured once more by a renderer of its own: what the clock alone makes different

    @property
    def remembers(self) -> bool:
        """Whether a picture depends on the frames before it."""
        return self.config.debug.sort_period > 1


@dataclass(frozen=True)
class Setting:
    """One choice of one knob."""

    knob: str
    label: str
    drawn: Drawn
    jpeg: tuple[int, str] | None = None  # quality and chroma of the picture sent


def base_config(context: Context) -> RenderConfig:
    """The defaults of this driver with nothing left to "auto", so that equal settings are measured once."""
    if not context.software:
        return RenderConfig(target="16f", debug=DebugConfig(shape="quad", fetch="attributes"))
    fetch: Literal["storage", "attributes"] = "storage" if context.vertex_storage else "attributes"
    return RenderConfig(target="32f", sorter="cpu", debug=DebugConfig(shape="triangle", fetch=fetch))


def settings_of(
    subject: Subject, base: RenderConfig, few: bool = False, compute: bool = False, pulled: bool = False
) -> list[Setting]:
    """The grid of a scene, the default first (and once more, for the noise of the clock).

    ``few``: of a knob with more than three settings only every second one and the default. ``compute``: the driver can
    sort on the GPU; ``pulled``: its vertex shaders read storage buffers.
    """
    default, cannot = Drawn(base), {"sorter": not compute, "fetch": not pulled}
    out = [Setting("default", "default", default), Setting("default", "once more", replace(default, copy=1))]
    for knob, field, values in CONFIG_KNOBS:
        if _matters(field, subject) and not cannot.get(field):
            of = base if hasattr(base, field) else base.debug
            for value in _some(values, few, getattr(of, field)):
                out.append(Setting(knob, str(value), Drawn(with_fields(base, **{field: value}))))
    if isinstance(subject.scene, Avatar):
        joints = subject.scene.skin.influences
        for k in (1, 2, 4, 8):
            if k < joints:
                out.append(Setting("influences", str(k), Drawn(with_fields(base, influences=k))))
        out.append(Setting("influences", str(joints) if subject.right else f"all ({joints})", default))
    splats = splats_of(subject.scene)
    if splats.cones is not None:
        out.append(Setting("hidden splats", "drawn", default))
        for margin in _some(CULL_MARGINS, few):
            culled = with_fields(base, cull_hidden=True, cull_margin=margin)
            out.append(Setting("hidden splats", f"margin {margin:g}", Drawn(culled)))
    levels = subject.scene.levels
    for level in range(len(levels) + 1 if levels else 0):
        out.append(Setting("level of detail", str(level), Drawn(replace(base, level=level))))
        if splats.cones is not None:
            lean = Drawn(replace(base, level=level, cull_hidden="auto"))
            out.append(Setting("level of detail", f"{level}, hidden by price", lean))
    if splats.sh_degree:
        for degree in range(splats.sh_degree):
            out.append(Setting("SH degree", str(degree), Drawn(replace(base, sh_degree=degree))))
        out.append(Setting("SH degree", str(splats.sh_degree), default))
    if len(splats) >= FEWEST:
        for share in _some(LEVELS, few):
            out.append(Setting("splats", f"{round(share * len(splats)):,}", Drawn(base, level=share)))
    for scale in (0.5, 0.75, 1.0):
        out.append(Setting("resolution", f"{scale:g} x", Drawn(base, scale=scale)))
    out += [Setting("JPEG", f"q{quality} {chroma}", default, (quality, chroma)) for quality, chroma in JPEGS]
    return out


def error_frames(subject: Subject, frames: int, few: bool = False) -> list[int]:
    """Frames whose pictures are held against float64: where an old order is at its oldest, whatever the period.

    Of ``frames`` measured after the warm-up the first, the middle and the last of these, or (``few``) the middle one.
    A camera that is given stands still in even frames: one is enough.
    """
    last = WARM_UP + frames - 1
    if subject.cameras:
        return [last - last % 2]
    oldest: Sequence[int] = range(LONGEST_PERIOD - 1, last + 1, LONGEST_PERIOD) or (last,)
    chosen = {len(oldest) // 2} if few else {0, len(oldest) // 2, len(oldest) - 1}
    return [oldest[i] for i in sorted(chosen)]


def _some(values: Sequence[Any], few: bool, default: Any = None) -> Sequence[Any]:
    """All, or of more than three every second one and the default."""
    return [v for i, v in enumerate(values) if i % 2 or v == default] if few and len(values) > 3 else values


def _matters(field: str, subject: Subject) -> bool:
    if field == "order":
        return len(subject.views(0)) == 2
    if field == "rotation":
        return isinstance(subject.scene, Avatar)
    if field == "sort_period":
        return not subject.cameras  # they do not move
    return True
