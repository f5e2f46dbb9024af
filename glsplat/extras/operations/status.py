"""The status page as plain HTML; web/status updates it if scripts run."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

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
