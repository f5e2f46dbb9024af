"""Clocks of a server in this process that a test moves by hand: nothing is waited for, and nothing comes too late."""

from __future__ import annotations

import asyncio
import time

import pytest

__all__ = ["Ahead", "Stopped"]


class Stopped:
    """Stands still until ``now`` is set: rates and budgets are what they are on paper."""

    def __init__(self) -> None:
        self.now = time.perf_counter()

    def __call__(self) -> float:
        return self.now


class Ahead:
    """Goes on with the machine's clock, ``leap`` seconds ahead of it: time limits are over at once."""

    def __init__(self) -> None:
        self._seconds = 0.0

    def __call__(self) -> float:
        return time.perf_counter() + self._seconds

    def lead(self) -> None:
        """Lead the running event loop, too: its timers, hence those of asyncio and aiohttp."""
        asyncio.get_running_loop().time = lambda: time.monotonic() + self._seconds  # type: ignore[method-assign]

    def leap(self, seconds: float) -> None:
        """Let so much time have passed."""
        self._seconds += seconds


def given_to_servers(clock: Stopped | Ahead, patch: pytest.MonkeyPatch) -> None:
    """Servers that are made from now on look at this clock."""
    patch.setattr("glsplat.net.served_scene.clock", clock)
