"""Latency: the paper's breakdown of the streaming pipeline beside the stages of a local server and client.

``measure(quick)`` starts a server in its own process, streams the embedded recording of head and hands
through it at 72 requests a second, and returns JSON-able values; ``rows(result)`` makes the table of them.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.errors import GlsplatError
from glsplat.net.client import Client

from ..demo import running_server
from ..replay.command import load_drive
from ..replay.streaming import STAGES, Drive, Result, observer, stream

PAPER = {
    "ik": "~1",
    "communication": "< 1",
    "wait": "",
    "render": "23-27",
    "encode": "1-2",
    "decode": "5-10",
    "end_to_end": "~30-41",
}
"""Stage -> ms in the paper's table "Latency breakdown of the streaming pipeline", its localhost setting, 2 x 1024².

Its tracking stage runs on the headset, its communication is one row, and its decoding includes the display.
"""

HEAD = ("stage", "where", "paper")
"""The first columns of ``rows``; two more, median and p95, follow for each size."""

_FPS = 72.0  # requests a second, as a headset's display
_SIZES = ((512, 512), (1024, 1024))
_SECONDS = (3.0, 8.0)  # of streaming at each size: quick, else
_WARM = 3  # pictures before: targets of the size, caches


def measure(quick: bool = False, avatar: Path | None = None) -> dict[str, Any]:
    """Stream the embedded recording through a server of an ``avatar`` (the default one); ``quick``: 512² only, 3 s.

    Returns::

        {"driver": str, "fps": 72.0, "paper": PAPER,
         "runs": [{"size": [w, h], "seconds": s, "shown": n, "sent": n, "dropped": n, "pictures_a_second": x,
                   "share_of_render_rate": x, "bytes_per_frame": n,
                   "stages": {stage: {"median": ms, "p95": ms}},        keys of streaming.STAGES
                   "beyond_render": {"median", "p95"}, "age": {"median", "p95"}}]}     from request to reply, on show

    Medians of stages need not add up to the median of their sum. GlsplatError if there is no server or no picture.
    """
    drive, _ = load_drive(None)
    count = round(_SECONDS[not quick] * _FPS)
    with running_server(None if avatar is None else str(avatar)) as url:
        results = [asyncio.run(_run(url, drive, size, count)) for size in _SIZES[: 1 if quick else None]]
    runs = [_values(result, size) for result, size in zip(results, _SIZES, strict=False)]
    return {"driver": results[0].driver, "fps": _FPS, "paper": PAPER, "runs": runs}


def rows(result: dict[str, Any]) -> list[list[str]]:
    """Return the table: HEAD with a median and a p95 column per size, then a row per stage; ms with one decimal."""
    head = [*HEAD]
    for run in result["runs"]:
        name = "2 x {}x{}".format(*run["size"])
        head += [f"{name}: median", "p95"]
    table = [head]
    for key, name, place in STAGES:
        cells = [name, place, result["paper"][key]]
        for run in result["runs"]:
            cells += [f"{run['stages'][key][number]:.1f}" for number in ("median", "p95")]
        table.append(cells)
    return table


async def _run(url: str, drive: Drive, size: tuple[int, int], count: int) -> Result:
    async with Client(url, timeout=30.0) as client:
        for _ in range(_WARM):
            await client.render(observer(0.0, np.zeros(3), size), tracking=drive.at(0.0).tracking)
        result = await stream(client, drive, frames=count, fps=_FPS, size=size)
    if not result.shown:
        raise GlsplatError(f"no picture came from the server{f': {result.last_error}' if result.last_error else ''}")
    return result


def _values(result: Result, size: tuple[int, int]) -> dict[str, Any]:
    summary = result.summary()
    return {
        "size": list(size),
        **{key: summary[key] for key in ("seconds", "sent", "shown", "dropped", "share_of_render_rate")},
        "pictures_a_second": summary["fps"],
        "bytes_per_frame": summary["bytes_per_frame"],
        "stages": {key: summary["stages_ms"][key] for key, _, _ in STAGES},
        "beyond_render": summary["beyond_render_ms"],
        "age": summary["age_ms"],
    }
