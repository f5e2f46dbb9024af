"""Numbers of the last five minutes, for the curves of the status page."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

log: logging.Logger = logging.getLogger("glsplat.net")

STEP_S = 2.0
"""Time between two values."""
MAX_VALUES = 150  # five minutes


class History:
    """Three values of /stats, recorded every STEP_S seconds."""

    def __init__(self) -> None:
        self._values: deque[tuple[float, float, float]] = deque(maxlen=MAX_VALUES)
        self._task: asyncio.Task[None] | None = None

    def start(self, stats: Callable[[], Mapping[str, Any]]) -> None:
        """Start recording ``stats``."""
        self._task = asyncio.create_task(self._run(stats), name="history")

    async def stop(self) -> None:
        """Stop recording; the values stay."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

    def add(self, stats: Mapping[str, Any], load: float) -> None:
        """Record pictures per second, the median of their ms on the server (0 without any) and the CPU ``load``."""
        total = stats["stages"].get("total", {}).get("median", 0.0) if stats["fps"] else 0.0
        self._values.append((float(stats["fps"]), float(total), round(load, 3)))

    def fields(self) -> dict[str, Any]:
        """Return the object of /history, oldest values first."""
        fps, age, load = (list(column) for column in zip(*self._values, strict=True)) if self._values else ([], [], [])
        return {"step": STEP_S, "most": MAX_VALUES, "fps": fps, "age": age, "load": load}

    async def _run(self, stats: Callable[[], Mapping[str, Any]]) -> None:
        failing = False
        while True:
            try:
                self.add(stats(), machine_load())
                failing = False
            except Exception:  # record further values after a gap
                if not failing:
                    log.exception("the figures of the status page cannot be measured")
                failing = True
            await asyncio.sleep(STEP_S)


def machine_load() -> float:
    """Return the runnable processes per core over the last minute; 0 if the system does not report them."""
    try:
        return os.getloadavg()[0] / (os.cpu_count() or 1)
    except (AttributeError, OSError):
        return 0.0
