"""The status page as plain HTML, /metrics, and the values of the page's curves; web/status updates the page."""

from __future__ import annotations

import asyncio
import contextlib
import html
import logging
import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
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


_COUNTERS = {
    "received": "messages received",
    "accepted": "requests that entered the mailbox",
    "dropped": "requests replaced by a newer one before they were drawn",
    "stale": "requests whose frame_id did not grow",
    "malformed": "messages that could not be used",
    "limited": "messages above the rate limit",
    "unread": "messages beyond a client's part of the time, dropped for newer ones",
    "failed": "pictures that could not be drawn",
    "sent": "replies sent",
    "posed": "replies in poses, of those sent",
    "bytes_sent": "bytes of replies sent",
}


def metrics_text(stats: Mapping[str, Any]) -> str:
    """Return the statistics in Prometheus' text exposition format 0.0.4."""
    lines = [
        *_metric("clients", "gauge", "connected clients", [("", stats["connected"])]),
        *_metric("up_seconds", "gauge", "seconds since the start", [("", stats["uptime"])]),
        *_metric("fps", "gauge", "pictures a second over the last five seconds", [("", stats["fps"])]),
        *_metric("refused_total", "counter", "connections refused", [("", stats["refused"])]),
        *_metric("turned_away_total", "counter", "connections closed unanswered", [("", stats["turned_away"])]),
        *_metric("waiting", "gauge", "connections that are no clients", [("", stats["waiting"])]),
        *_metric("held_off", "gauge", "addresses that are held off", [("", stats["held_off"])]),
        *_metric("rebuilds_total", "counter", "OpenGL contexts lost and made anew", [("", stats["rebuilds"])]),
    ]
    if stats["workers"] is not None:
        alive = sum(worker["alive"] for worker in stats["workers"])
        lines += _metric("workers", "gauge", "workers that draw", [("", alive)])
    for name, text in _COUNTERS.items():
        lines += _metric(f"{name}_total", "counter", text, [("", stats["totals"][name])])
    stages = [
        (f'{{stage="{stage}",quantile="{quantile}"}}', times[key])
        for stage, times in stats["stages"].items()
        for quantile, key in (("0.5", "median"), ("0.95", "p95"))
    ]
    lines += _metric("stage_milliseconds", "gauge", "time of a stage over the last frames", stages)
    return "\n".join(lines) + "\n"


def _metric(name: str, kind: str, text: str, values: Sequence[tuple[str, float]]) -> list[str]:
    head = [f"# HELP glsplat_{name} {text}", f"# TYPE glsplat_{name} {kind}"]
    return head + [f"glsplat_{name}{labels} {value}" for labels, value in values]


STATUS_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' blob: data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content-Security-Policy of the page."""


_LOOPBACK_ONLY = (
    'alone: <a href="vr/">the viewer</a>. This server listens on this computer alone: no phone and no headset in the '
    "network reaches it. For those start it with <code>glsplat serve --host 0.0.0.0 --self-signed</code>."
)


def page_html(stats: Mapping[str, Any], url: str, viewer: str, code: str = "") -> str:
    """Return the page, which reloads itself without scripts.

    ``url`` is the WebSocket's, ``viewer`` the viewer's for other devices ("": not reachable), ``code`` its QR code as
    an HTML element.
    """
    url, viewer = html.escape(url), html.escape(viewer)
    options = " --token-file FILE" if stats["token"] else ""
    token = ', token="..."' if stats["token"] else ""
    asks = " It asks for the token." if stats["token"] else ""
    options += " --tls-ca PEM" if url.startswith("wss:") else ""
    see = f'or in a headset: <a href="vr/">the viewer</a>, <code>{viewer}</code>.{asks}' if viewer else _LOOPBACK_ONLY
    scene = f"{html.escape(stats['scene'])} on " if stats["scene"] else ""
    stages = [(name, f"{t['median']:.2f}", f"{t['p95']:.2f}") for name, t in stats["stages"].items()]
    counts = ("sent", "dropped", "stale", "malformed", "failed", "unacknowledged", "window")
    keys = ("id", "avatar", "form", "size", *counts)
    clients = [[client[key] for key in keys] for client in stats["clients"]]
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>glsplat server</title>
<noscript><meta http-equiv="refresh" content="2"></noscript>
<meta name="viewport" content="width=device-width, initial-scale=1"><meta name="color-scheme" content="light dark">
<link rel="icon" href="vr/icon.svg" type="image/svg+xml"><link rel="stylesheet" href="vr/tokens.css">
<link rel="stylesheet" href="vr/status/status.css"><script type="module" src="vr/status/main.js"></script></head><body>
<header><h1>glsplat server</h1><a class="first" href="vr/">Open the viewer</a></header>
<main>
<p id="summary">{scene}{html.escape(stats["driver"])}; up {stats["uptime"]:.0f} s,
{stats["totals"]["sent"]} pictures sent, {stats["fps"]:.1f} a second,
{stats["connected"]} of {stats["max_clients"]} clients, {"healthy" if stats["healthy"] else "failing"}.</p>
<p id="trouble" role="status" aria-live="polite"></p>
<section id="curves" aria-label="The last five minutes" hidden></section>
<section id="now" aria-labelledby="now-title" hidden><h2 id="now-title">Now</h2>
<div id="pictures" class="grid"></div></section>
<section aria-labelledby="clients-title"><h2 id="clients-title">Clients</h2>
<div id="clients" class="wide" tabindex="0" role="group" aria-labelledby="clients-title">
{_table(keys, clients)}</div></section>
<section id="avatars" aria-labelledby="avatars-title" hidden><h2 id="avatars-title">Avatars</h2>
<div id="people" class="grid"></div></section>
<section aria-labelledby="connect-title"><h2 id="connect-title">Connect</h2>
<p>To see it, here {see}</p>
<div class="code">{code}</div>
<p>The WebSocket is <code>{url}</code>; what it speaks is in docs/protocol.md. To measure it, from a terminal:</p>
<pre tabindex="0">glsplat replay --url {url}{options}</pre>
<p>To look at what it draws:</p>
<pre tabindex="0">glsplat preview --connect {url}{options}</pre>
<p>From Python:</p>
<pre tabindex="0">async with glsplat.net.client.Client("{url}"{token}) as client:
    reply = await client.render(cameras, pose=pose)    # cameras: one, or glsplat.stereo_cameras(...)
    left, right = reply.images()</pre>
<p>Numbers: <a href="/stats">/stats</a> (JSON), <a href="/metrics">/metrics</a> (Prometheus),
<a href="/healthz">/healthz</a>.</p></section>
<section aria-labelledby="stages-title"><h2 id="stages-title">Stages (ms)</h2>
<div id="stages">{_table(("stage", "median", "p95"), stages)}</div></section>
</main></body></html>
"""


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    def row(cells: Sequence[object], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in cells) + "</tr>"

    if not rows:
        return "<p>none yet</p>"
    return "<table>" + row(head, "th") + "".join(row(cells, "td") for cells in rows) + "</table>"
