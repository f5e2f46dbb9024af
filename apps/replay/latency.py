"""Latency: the paper's breakdown of the streaming pipeline beside the stages of a local server and client.

``measure`` starts a server in its own process and streams the embedded recording of head and hands through it at 72
requests a second.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from ..demo import running_server, streamed
from .command import check_shown, load_drive
from .streaming import STAGES

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

_FPS = 72.0  # requests a second, as a headset's display
_SIZES = ((512, 512), (1024, 1024))
_SECONDS = (3.0, 8.0)  # of streaming at each size: quick, else


def measure(quick: bool = False, avatar: Path | None = None) -> dict[str, Any]:
    """Stream the embedded recording through a server of an ``avatar`` (the default one); ``quick``: 512² only, 3 s.

    Returns {"driver", "runs": [{"size", "pictures_a_second", "stages": {key of STAGES: {"median": ms, "p95": ms}}}]} as
    JSON values. Medians of stages need not add up to the median of their sum. GlsplatError without server or picture.
    """
    drive, _ = load_drive(None)
    count = round(_SECONDS[not quick] * _FPS)
    with running_server(None if avatar is None else str(avatar)) as url:
        results = asyncio.run(streamed(url, drive, _SIZES[: 1 if quick else None], count, _FPS))
    check_shown(results)
    runs = []
    for result, size in zip(results, _SIZES, strict=False):
        summary = result.summary()
        stages = {key: summary["stages_ms"][key] for key, _, _ in STAGES}
        runs.append({"size": list(size), "pictures_a_second": summary["fps"], "stages": stages})
    return {"driver": results[0].driver, "runs": runs}


def rows(result: dict[str, Any]) -> list[list[str]]:
    """Return the table, ms with one decimal: a row per stage, with a median and a p95 column per size."""
    head = ["stage", "where", "paper"]
    for run in result["runs"]:
        name = "2 x {}x{}".format(*run["size"])
        head += [f"{name}: median", "p95"]
    table = [head]
    for key, name, place in STAGES:
        cells = [name, place, PAPER[key]]
        for run in result["runs"]:
            cells += [f"{run['stages'][key][number]:.1f}" for number in ("median", "p95")]
        table.append(cells)
    return table
