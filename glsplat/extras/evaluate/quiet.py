"""The gate of measurements: the load by other processes, and the difference of the default to itself."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

MAX_SHARE = 0.03
"""Largest share for valid times: of the cores used by others, and of the default's difference to itself."""


@dataclass(frozen=True)
class Quiet:
    """How quiet the machine was during a measurement."""

    others: float | None  # share of all cores used by other processes and the host; None: not Linux
    noise: float | None = None  # relative difference of the default to itself; None: not measured

    @property
    def ok(self) -> bool:
        """Whether both shares are at most MAX_SHARE or unknown."""
        return all(share is None or share <= MAX_SHARE for share in (self.others, self.noise))

    @property
    def words(self) -> str:
        """Both shares in words."""
        parts = [] if self.others is None else [f"other processes used {self.others:.1%} of the cores"]
        parts += [] if self.noise is None else [f"the default differs from itself by {self.noise:.1%}"]
        return ", ".join(parts) or "not known here"


class Watch:
    """Measures the CPU time of other processes since its creation; children count as own once waited for."""

    def __init__(self) -> None:
        self._start = _seconds()

    def read(self, noise: float | None = None) -> Quiet:
        """Return how quiet the machine was since the creation."""
        end, noise = _seconds(), None if noise is None else round(noise, 4)
        if self._start is None or end is None:
            return Quiet(None, noise)
        total, busy, own = (after - before for after, before in zip(end, self._start, strict=True))
        return Quiet(round(max(0.0, busy - own) / max(total, 1e-9), 4), noise)


def until_quiet(
    measure: Callable[[int], tuple[T, float | None]], frames: int, say: Callable[[str], object] = print
) -> tuple[T, Quiet]:
    """Return (result, quiet) of ``measure(frames)``, which returns (result, noise).

    On a busy machine measure once more with twice the frames; ``say`` gets a line if it is still busy.
    """
    for count in (frames, 2 * frames):
        watch = Watch()
        result, noise = measure(count)
        quiet = watch.read(noise)
        if quiet.ok:
            break
    else:
        say(f"not a quiet machine: {quiet.words}; expected at most {MAX_SHARE:.0%}; compare CPU times, or end others")
    return result, quiet


def _seconds() -> tuple[float, float, float] | None:
    """Return seconds of all cores: (in all, busy, busy for this process and the children it waited for)."""
    try:
        line = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0]
    except OSError:
        return None
    times = [int(word) / os.sysconf("SC_CLK_TCK") for word in line.split()[1:9]]
    return sum(times), sum(times) - times[3] - times[4], sum(os.times()[:4])  # without idle and iowait
