"""Tidy tables: what was answered, once, with its condition; sidecars that name every column."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from glsplat.errors import FormatError
from glsplat.extras.study.export import export
from glsplat.extras.study.plan import label, steps_of
from glsplat.extras.study.session import Event, Session
from glsplat.extras.study.store import FRAMES, Store
from tests.extras.study.designs import planned
from tests.extras.study.test_session import Walk


def kept(folder: Path, participant: int, walk: Walk) -> Path:
    store = Store(folder, participant)
    store.append(walk.log)
    store.close()
    return store.folder


def table(folder: Path, name: str) -> list[dict[str, str]]:
    with open(folder / f"{name}.csv", newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    """Participant 1 is done, 2 is under way with a repeated questionnaire, 3 declined; 4 to 6 never came."""
    data = tmp_path / "data"
    one, two, three = (Walk(tmp_path, number) for number in (1, 2, 3))
    one.open()
    while one.session.step:
        one.step()
    two.to("questionnaire")
    two.do(two.session.answer, two.name, "mental", 35, 2.0)
    two.do(two.session.repeat)
    two.do(two.session.answer, two.name, "mental", 60, 3.5)
    two.do(two.session.answer, two.name, "effort", 20, 1.0)
    two.do(two.session.answer, two.name, "effort", 25, 1.0)
    three.do(lambda t: three.session.consent("001-consent", False, t))
    for number, walk in ((1, one), (2, two), (3, three)):
        kept(data, number, walk)
    ran = [e for e in one.log if e.values.get("phase") == "running"]
    lines = [
        {"t": e.t + k, "step": e.step, "kind": "frames", "values": {"fps": 50 + k, "age_ms": 30.0, "session": "vr"}}
        for e in ran
        for k in (-1, 1, 2, 3, 99)  # the first and the last lie outside the task
    ]
    text = "\n".join(map(json.dumps, lines)) + '\n{"t": 3, "values"'  # torn
    (data / label(1) / FRAMES).write_text(text)
    done = export(one.study, one.plan, data, tmp_path / "tables")
    assert done.remarks == (
        "3 of 6 participants have no data yet",
        "sub-002: under way at step 2 of 11",
        "sub-003: declined at step 1 of 11",
    )
    return tmp_path / "tables"


def test_every_answer_once(tables: Path) -> None:
    rows = table(tables, "answers")
    assert len(rows) == (6 + 2 * 3 + 6 + 4) + 2
    keys = [(row["participant"], row["step"], row["item"]) for row in rows]
    assert len(set(keys)) == len(rows)
    two = {row["item"]: (row["value"], row["seconds"]) for row in rows if row["participant"] == "sub-002"}
    assert two == {"mental": ("60", "3.5"), "effort": ("25", "1.0")}  # of the attempt that counts, the last
    assert {row["condition"] for row in rows if row["questionnaire"] == "movement"} == {"fast", "slow"}
    assert {(row["condition"], row["delay"]) for row in rows} == {("fast", "none"), ("slow", "some"), ("", "")}


def test_scores_are_of_what_is_finished(tables: Path) -> None:
    rows = table(tables, "scores")
    assert {row["participant"] for row in rows} == {"sub-001"}
    moved = ["movement.realism", "movement.naturalness", "movement.synchrony"]
    assert [r["measure"] for r in rows] == ["nasa-tlx.raw.before", *moved, *moved, "nasa-tlx.raw", "own.sum"]
    assert list(rows[0]) == ["participant", "position", "condition", "delay", "group", "measure", "value"]
    assert float(rows[-1]["value"]) == 0.5 * (7 + -2 * -3)  # odd 1, reversed; fine -3
    assert {row["group"] for row in rows} <= {"old", "young"}


def test_frames_are_of_the_task_alone(tables: Path) -> None:
    rows = table(tables, "frames")
    assert len(rows) == 4
    assert {(row["samples"], row["fps"], row["age_ms"]) for row in rows} == {("3", "52", "30.0")}


def test_sidecars_name_every_column(tables: Path) -> None:
    for name in ("participants", "answers", "scores", "frames"):
        with open(tables / f"{name}.csv", newline="") as file:
            columns = next(csv.reader(file))
        sidecar = json.loads((tables / f"{name}.json").read_text())
        assert [key for key in sidecar if key != "Study"] == columns
        assert all(sidecar[key]["Description"] for key in columns)
    study = json.loads((tables / "scores.json").read_text())["Study"]
    assert study["factors"] == {
        "delay": {"levels": ["none", "some"], "kind": "within"},
        "group": {"levels": ["old", "young"], "kind": "between"},
    }
    assert study["measures"]["own.sum"]["reversed"] == ["own.odd", "own.fine"]  # fine by its weight
    assert set(study["measures"]) >= {row["measure"] for row in table(tables, "scores")}


def test_words_are_no_formulas(tmp_path: Path) -> None:
    """What a participant writes is not run by whoever opens the table in a spreadsheet."""
    walk = Walk(tmp_path)
    while walk.name != "011-own":
        walk.step()
    said = '=HYPERLINK("http://x","y")\n"quoted", and é'
    walk.do(walk.session.answer, walk.name, "words", said, 1.0)
    kept(tmp_path / "data", 1, walk)
    export(walk.study, walk.plan, tmp_path / "data", tmp_path / "out")
    (row,) = [row for row in table(tmp_path / "out", "answers") if row["item"] == "words"]
    assert row["value"] == "'" + said


def test_a_changed_log_stops_the_export(tables: Path, tmp_path: Path) -> None:
    study, plan = planned(tmp_path)
    before = {path.name: path.read_bytes() for path in tables.iterdir()}
    export(study, plan, tmp_path / "data", tables)
    assert {path.name: path.read_bytes() for path in tables.iterdir()} == before  # again the same bytes
    path = tmp_path / "data" / "sub-001" / "session.jsonl"
    path.write_bytes(path.read_bytes().replace(b'"value":0', b'"value":5', 1))
    with pytest.raises(FormatError, match="line"):
        export(study, plan, tmp_path / "data", tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_a_log_of_another_plan_is_not_believed(tmp_path: Path) -> None:
    """Lines that the steps do not allow change nothing, or say so; nothing crashes."""
    study, plan = planned(tmp_path)
    store = Store(tmp_path / "data", 1)
    store.append([Event(1.0, "900-x", "phase", {"phase": "running"}), Event(2.0, "900-x", "done", {"attempt": 1})])
    store.close()
    with pytest.raises(FormatError, match="sub-001"):
        export(study, plan, tmp_path / "data", tmp_path / "out")
    assert Session(study, steps_of(study, plan, 1)).state.at == 0
