"""/metrics: numbers of a server in Prometheus' text format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

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
