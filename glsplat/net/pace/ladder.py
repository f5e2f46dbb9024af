"""The quality ladder: rungs of size and JPEG quality for pictures on a slow link, the best first.

The steps are the Pareto front of docs/measured/ladder.md in bytes and LPIPS, over four avatars
(``python -m tools.docs.measured ladder``). The first rung crops the black around the avatar, which takes over a third
of a picture's bytes. Coarser chroma is no step: 4:1:1 takes more bytes than 4:2:0. The table is of still pictures; for
their rate see ``MAX_SMOOTH_LPIPS``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import exp, log


@dataclass(frozen=True, slots=True)
class Step:
    """A row of the measured table."""

    scale: float  # of the picture's sides
    quality: int  # JPEG
    nbytes: float  # of the avatar's box, relative to full size and quality 80
    lpips: float  # against the uncompressed picture of full size


SCALES = (1.0, 0.875, 0.75, 0.625, 0.5)
"""Scales of a picture's side."""

STEPS = (
    Step(1.0, 95, 1.94, 0.0026),
    Step(1.0, 90, 1.40, 0.0042),
    Step(1.0, 80, 1.00, 0.0084),
    Step(1.0, 70, 0.83, 0.0131),
    Step(1.0, 60, 0.72, 0.0175),
    Step(1.0, 50, 0.65, 0.0231),
    Step(1.0, 40, 0.59, 0.0288),
    Step(1.0, 30, 0.52, 0.0396),
    Step(1.0, 20, 0.44, 0.0598),
    Step(0.875, 30, 0.43, 0.0755),
    Step(0.75, 40, 0.39, 0.0955),
    Step(0.75, 30, 0.346, 0.1072),
    Step(0.75, 20, 0.298, 0.1316),
    Step(0.625, 30, 0.273, 0.1507),
    Step(0.625, 20, 0.234, 0.1731),
    Step(0.5, 30, 0.205, 0.2070),
    Step(0.5, 20, 0.171, 0.2290),
    Step(0.5, 10, 0.132, 0.2768),
)
"""By size, from the best quality on the front to the worst."""

CROPPED_SHARE = 0.62
"""Bytes of the avatar's box, relative to the whole picture."""

MAX_SMOOTH_LPIPS, REDUCED_FPS = 0.03, 25.0
"""Pictures of a higher LPIPS are sent at the reduced rate first, before their quality is lowered further."""

_QUALITY_STEP = 2  # from one rung to the next


@dataclass(frozen=True, slots=True)
class Rung:
    """The size and quality of a picture. ``bits`` are relative to the picture that was requested."""

    scale: float
    quality: int
    crop: bool
    bits: float

    @property
    def full(self) -> bool:
        """Whether the picture is as requested."""
        return self.bits == 1.0


@lru_cache(maxsize=128)
def ladder(quality: int, crop: bool) -> tuple[Rung, ...]:
    """Return the rungs for a picture of that ``quality``, whole or cropped, by falling ``bits``; the first has 1."""
    requested = _interpolated(1.0, quality).nbytes
    whole = 1.0 if crop else CROPPED_SHARE
    found = [Rung(1.0, quality, crop, 1.0), *([] if crop else [Rung(1.0, quality, True, CROPPED_SHARE)])]
    for scale in SCALES:
        steps = [step for step in STEPS if step.scale == scale]
        best, worst = steps[0].quality, steps[-1].quality
        for finer in [*range(min(best, quality), worst, -_QUALITY_STEP), worst]:
            bits = whole * _interpolated(scale, finer).nbytes / requested
            if finer <= quality and bits < found[-1].bits:
                found.append(Rung(scale, finer, True, bits))
    return tuple(found)


def visible_loss(rung: Rung) -> float:
    """Return the LPIPS of a picture on that rung, by the table."""
    return _interpolated(rung.scale, rung.quality).lpips


def _interpolated(scale: float, quality: int) -> Step:
    steps = [step for step in STEPS if step.scale == scale]
    quality = min(max(quality, steps[-1].quality), steps[0].quality)
    finer = min((step for step in steps if step.quality >= quality), key=lambda step: step.quality)
    coarser = max((step for step in steps if step.quality <= quality), key=lambda step: step.quality)
    if finer is coarser:
        return finer
    part = (finer.quality - quality) / (finer.quality - coarser.quality)
    nbytes = exp(log(finer.nbytes) + part * log(coarser.nbytes / finer.nbytes))
    return Step(scale, quality, nbytes, finer.lpips + part * (coarser.lpips - finer.lpips))
