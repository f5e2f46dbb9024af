"""Logs beyond the size that a link may append: a session goes on in them, they are exported, in constant memory."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest

from glsplat.extras.study.export import export
from glsplat.extras.study.serving.live import Live
from glsplat.extras.study.session import Event
from glsplat.extras.study.store import Store
from tests.extras.study.designs import planned
from tests.extras.study.test_session import Walk

ROOT = Path(__file__).resolve().parents[3]
WORDS = "\U00010000" * 4000  # the longest answer: 48 kB of JSON


def grown(folder: Path, nbytes: int) -> int:
    """A log of ``nbytes`` of changed answers to the last questionnaire, and how many there are."""
    walk = Walk(folder)
    walk.open()
    while walk.name != "011-own":
        walk.step()
    store = Store(folder / "data", 1)
    store.append(walk.log)
    count = 0
    while store.size < nbytes:
        values = ({"item": "words", "value": f"{count + n} {WORDS[6:]}", "seconds": 1.0} for n in range(20))
        store.append([Event(walk.t, walk.name, "answer", each) for each in values])
        count += 20
    store.close()
    return count


def exported(folder: Path) -> str:
    """The words in the table of answers."""
    study, plan = planned(folder)
    export(study, plan, folder / "data", folder / "out")
    with open(folder / "out" / "answers.csv", newline="", encoding="utf-8") as file:
        (row,) = [row for row in csv.DictReader(file) if row["item"] == "words"]
    return row["value"]


def at_the_end(folder: Path) -> str:
    """The words that a session has whose server opens the log anew and writes a note."""
    study, plan = planned(folder)
    live = Live(study, plan, 1, folder / "data")
    live.store.append(live.session.note("opened", live.session.state.since))
    live.store.close()
    return str(live.session.state.answers["words"])


@pytest.mark.check
def test_a_log_is_exported_in_constant_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        count = grown(tmp_path, 8 << 20)
    figures = '{"t":1.0,"step":"003-fast-wave","kind":"frames","values":{"fps":50.0,"session":"vr"}}\n'
    (tmp_path / "data" / "sub-001" / "frames.jsonl").write_text(figures * 80_000)
    tracemalloc.start()
    words = exported(tmp_path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert words == f"{count - 1} {WORDS[6:]}"
    assert peak < 3 << 20  # of 15 MB


@pytest.mark.check
def test_three_hundred_megabytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More than was ever read: the session goes on where it was, and no process grows with the file."""
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        count = grown(tmp_path, 300 << 20)
    code = f"""
import resource
from pathlib import Path
from tests.extras.study.test_large_logs import at_the_end, exported

before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
folder = Path({str(tmp_path)!r})
print(at_the_end(folder).split()[0], exported(folder).split()[0])
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) >> 10)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    live, table, grew = done.stdout.split()
    assert live == table == f"{count - 1}" and int(grew) < 40  # MiB
