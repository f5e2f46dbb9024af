"""``glsplat study power``: a table a number of participants, JSON, a pilot, and mistakes in one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from apps.study import power
from apps.usage import UsageError
from tests.apps.cli import mistake, parsed

FACTORS = ["--within", "type=self,other", "--within", "method=ours,video,image"]


def test_a_plan(capsys: pytest.CaptureFixture[str]) -> None:
    words = [*FACTORS, "--participants", "8", "24", "--effect", "type=0.6", "--runs", "200", "--seed", "3"]
    assert power.run(parsed(power, *words)) == 0
    first = capsys.readouterr().out
    assert "8 participants, 200 simulated studies, alpha 0.05:" in first and first.count("type:method") == 2
    power.run(parsed(power, *words, "--json"))
    rows = json.loads(capsys.readouterr().out)
    by = {(row["participants"], row["effect"]): row for row in rows}
    assert by[24, "type"]["power"] > by[8, "type"]["power"] + 0.1 > by[24, "method"]["power"] + 0.2
    assert f"power {by[24, 'type']['power']:.3f}" in first and by[8, "type"]["low"] < by[8, "type"]["power"]


def test_a_pilot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    rows = [f"{p},{w},{rng.normal() + 2 * (w == 'x'):.2f}" for p in range(8) for w in "xy"]
    (tmp_path / "pilot.csv").write_text("participant,w,value\n" + "\n".join(rows) + "\n")
    pilot = str(tmp_path / "pilot.csv")
    words = ["--pilot", pilot, "--factors", "w", "--participants", "20", "--runs", "100", "--json"]
    assert power.run(parsed(power, *words)) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["effect"] == "w" and row["power"] > 0.9
    with pytest.raises(UsageError, match="--factors is needed"):
        power.run(parsed(power, "--pilot", str(tmp_path / "pilot.csv"), "--participants", "20"))
    with pytest.raises(UsageError, match="leave out"):
        power.run(parsed(power, *words, "--effect", "w=1"))


def test_mistakes(capsys: pytest.CaptureFixture[str]) -> None:
    both = " ".join(FACTORS)
    for words, said in (
        ("--participants 12", "name the factors"),
        (both, "--participants is needed"),
        (f"{both} --participants 12 --effect type", "--effect needs NAME=NUMBER"),
        (f"{both} --participants 12 --effect colour=1", "expected factors"),
        ("--within type=self --participants 12", "--within needs NAME=LEVEL,LEVEL"),
        (f"{both} --between type=a,b --participants 12", "--between needs"),
        (f"{both} --participants 12 --runs 0", "a run or more"),
        (f"{both} --participants 1", "2 participants or more"),
        (f"{both} --participants 12 --points 1", "2 to 1000 points"),
    ):
        assert said in mistake(capsys, "study", "power", *words.split())
