"""The report's latency section: a real server, a short stream, and the table."""

from __future__ import annotations

import json
import multiprocessing

import pytest

from apps.replay.streaming import STAGES
from apps.report import latency as report_latency


@pytest.mark.check
@pytest.mark.gl
def test_a_short_stream_is_measured_stage_by_stage(monkeypatch):
    monkeypatch.setattr(report_latency, "_SIZES", ((64, 64), (96, 96)))
    monkeypatch.setattr(report_latency, "_SECONDS", (0.5, 0.6))
    ticks = []
    result = report_latency.measure(quick=False, progress=ticks.append)
    assert json.loads(json.dumps(result)) == result and not multiprocessing.active_children()
    assert sum(ticks) == report_latency.frames(quick=False) == 86
    assert [run["size"] for run in result["runs"]] == [[64, 64], [96, 96]] and result["driver"]
    for run in result["runs"]:
        stages = run["stages"]
        assert list(stages) == [key for key, _, _ in STAGES] and run["shown"] >= 1
        assert all(0 <= stage["median"] <= stage["p95"] for stage in stages.values())
        assert min(stages[key]["median"] for key in ("ik", "render", "encode", "decode")) > 0
        assert stages["end_to_end"]["p95"] >= max(stage["median"] for stage in stages.values())
    table = report_latency.rows(result)
    assert table[0] == ["stage", "where", "paper", "2 x 64x64: median", "p95", "2 x 96x96: median", "p95"]
    assert [row[:3] for row in table[1:]] == [[name, place, result["paper"][key]] for key, name, place in STAGES]
    assert all(len(row) == 7 and float(row[3]) >= 0 for row in table[1:])
