"""The last five minutes of a server in numbers, for the curves of its status page."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

__all__ = ["History"]

log: logging.Logger = logging.getLogger("glsplat.net")

STEP = 2.0
"""Seconds between two values."""
_LENGTH = 150  # values: five minutes


class History:
    """Three numbers of /stats, taken every STEP seconds."""

    def __init__(self) -> None:
        self._values: deque[tuple[float, float, float]] = deque(maxlen=_LENGTH)
        self._task: asyncio.Task[None] | None = None

    def start(self, stats: Callable[[], Mapping[str, Any]]) -> None:
        """Take the numbers of ``stats`` from now on."""
        self._task = asyncio.create_task(self._run(stats), name="history")

    async def stop(self) -> None:
        """What was taken stays."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

    def add(self, stats: Mapping[str, Any], load: float) -> None:
        """One value each: pictures a second, the median of their ms at the server (0 without any), ``load``."""
        total = stats["stages"].get("total", {}).get("median", 0.0) if stats["fps"] else 0.0
        self._values.append((float(stats["fps"]), float(total), round(load, 3)))

    def fields(self) -> dict[str, Any]:
        """JSON of /history, the oldest first."""
        fps, age, load = (list(column) for column in zip(*self._values, strict=True)) if self._values else ([], [], [])
        return {"step": STEP, "most": _LENGTH, "fps": fps, "age": age, "load": load}

    async def _run(self, stats: Callable[[], Mapping[str, Any]]) -> None:
        failing = False
        while True:
            try:
                self.add(stats(), machine_load())
                failing = False
            except Exception:  # a curve with a hole is better than none from here on
                if not failing:
                    log.exception("the numbers of the status page cannot be taken just now")
                failing = True
            await asyncio.sleep(STEP)


def machine_load() -> float:
    """Processes that want a core, per core, over the last minute; 0 where the system does not say."""
    try:
        return os.getloadavg()[0] / (os.cpu_count() or 1)
    except (AttributeError, OSError):
        return 0.0
