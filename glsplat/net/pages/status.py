"""What the server says about itself: /stats (JSON), /metrics (Prometheus text) and the status page (plain HTML)."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["metrics_text", "page_html"]

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
    """The statistics in Prometheus' text exposition format 0.0.4."""
    lines = [
        *_metric("clients", "gauge", "connected clients", [("", len(stats["clients"]))]),
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


def page_html(stats: Mapping[str, Any], url: str, viewer: str, code: str = "") -> str:
    """A page without scripts and without other resources; it reloads itself.

    ``url`` is the WebSocket's address, ``viewer`` the other page's, ``code`` the latter as a QR code (an element).
    """
    url, viewer = html.escape(url), html.escape(viewer)
    options = " --token-file FILE" if stats["token"] else ""
    token = ', token="..."' if stats["token"] else ""
    asks = " It asks for the token." if stats["token"] else ""
    options += " --tls-ca PEM" if url.startswith("wss:") else ""
    stages = [(name, f"{t['median']:.2f}", f"{t['p95']:.2f}") for name, t in stats["stages"].items()]
    keys = ("id", "form", "size", "sent", "dropped", "stale", "malformed", "failed", "unacknowledged", "window")
    clients = [[client[key] for key in keys] for client in stats["clients"]]
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>glsplat server</title>
<meta http-equiv="refresh" content="2"><meta name="viewport" content="width=device-width">
<style>body{{font:15px/1.5 system-ui,sans-serif;margin:2rem;max-width:60rem}}table{{border-collapse:collapse}}
td,th{{padding:.15rem .8rem;text-align:right;border-bottom:1px solid #ccc}}</style></head><body>
<h1>glsplat server</h1>
<p>{html.escape(stats["scene"])} on {html.escape(stats["driver"])}; up {stats["uptime"]:.0f} s,
{stats["totals"]["sent"]} pictures sent, {stats["fps"]:.1f} a second,
{len(stats["clients"])} of {stats["max_clients"]} clients, {"healthy" if stats["healthy"] else "failing"}.</p>
<h2>Connect</h2>
<p>To see it, here or in a headset: <a href="vr/">the viewer</a>, <code>{viewer}</code>.{asks}</p>
{code}
<p>The WebSocket is <code>{url}</code>; what it speaks is in docs/protocol.md. To measure it, from a terminal:</p>
<pre>glsplat replay --url {url}{options}</pre>
<p>To look at what it draws:</p>
<pre>glsplat preview --connect {url}{options}</pre>
<p>From Python:</p>
<pre>async with glsplat.net.client.Client("{url}"{token}) as client:
    reply = await client.render(cameras, pose=pose)    # cameras: one, or glsplat.stereo_cameras(...)
    left, right = reply.images()</pre>
<p>Numbers: <a href="/stats">/stats</a> (JSON), <a href="/metrics">/metrics</a> (Prometheus),
<a href="/healthz">/healthz</a>.</p>
<h2>Stages (ms)</h2>{_table(("stage", "median", "p95"), stages)}
<h2>Clients</h2>{_table(keys, clients)}
</body></html>
"""


def _metric(name: str, kind: str, text: str, values: Sequence[tuple[str, float]]) -> list[str]:
    head = [f"# HELP glsplat_{name} {text}", f"# TYPE glsplat_{name} {kind}"]
    return head + [f"glsplat_{name}{labels} {value}" for labels, value in values]


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    def row(cells: Sequence[object], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in cells) + "</tr>"

    if not rows:
        return "<p>none yet</p>"
    return "<table>" + row(head, "th") + "".join(row(cells, "td") for cells in rows) + "</table>"
