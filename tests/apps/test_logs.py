"""Log lines: one a record, with a UTC time stamp, as text or JSON."""

from __future__ import annotations

import argparse
import json
import logging
import re
from datetime import UTC, datetime

import pytest

from apps.logs import start_logging
from apps.serve import command as serve
from tests.apps.cli import serving

STAMP = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z"


def lines(capsys: pytest.CaptureFixture[str], kind: str) -> list[str]:
    start_logging(kind, logging.WARNING)
    log = logging.getLogger("glsplat.net")
    log.info("not shown")
    log.warning("client %d sent %r", 3, "a\nb")
    log.error('fake\n{"level": "critical"}\x1b[2J \u2028 ü')
    try:
        raise ValueError("why")
    except ValueError:
        log.exception("a picture failed")
    out, err = capsys.readouterr()
    assert out == ""
    return err.splitlines()


def test_json_is_one_object_a_line(capsys):
    before = datetime.now(UTC)
    records = [json.loads(line) for line in lines(capsys, "json")]
    assert [r["level"] for r in records] == ["warning", "error", "error"]
    assert {r["logger"] for r in records} == {"glsplat.net"}
    assert records[0]["message"] == "client 3 sent 'a\\nb'"
    assert records[1]["message"] == 'fake\n{"level": "critical"}\x1b[2J \u2028 ü'
    assert "ValueError: why" in records[2]["traceback"] and "traceback" not in records[0]
    for record in records:
        assert re.fullmatch(STAMP, record["time"])
        assert abs((datetime.fromisoformat(record["time"]) - before).total_seconds()) < 60


def test_text_has_time_level_and_logger(capsys):
    got = lines(capsys, "text")
    assert re.fullmatch(rf"{STAMP} WARNING glsplat\.net: client 3 sent 'a\\nb'", got[0])
    assert re.fullmatch(rf"{STAMP} ERROR glsplat\.net: fake\\n.*\\x1b\[2J \\u2028 ü", got[1])
    assert got[3] == "Traceback (most recent call last):" and got[-1] == "ValueError: why"


def test_the_server_logs_as_asked(capsys, monkeypatch):
    class Quiet:
        url, port, drawer = "ws://192.0.2.1:8000/ws", 8000, argparse.Namespace(driver="none")
        config = argparse.Namespace(fit=False)

        async def run(self, started):
            started()
            logging.getLogger("glsplat.net").warning("here")

    monkeypatch.setattr(serve, "_server", lambda *_: Quiet())
    assert serve.run(serving("log-format=json", "--host", "192.0.2.1", "--insecure")) == 0
    messages = [json.loads(line)["message"] for line in capsys.readouterr().err.splitlines()]
    assert messages == ["anybody who reaches this port can use it (--insecure)", "here"]
