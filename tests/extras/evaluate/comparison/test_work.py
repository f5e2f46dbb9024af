"""Tasks: what is made, kept, made again, and what fails; in this process and in others."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.evaluate.comparison import tables
from glsplat.extras.evaluate.comparison import work as working
from glsplat.extras.evaluate.comparison.method import MadeElsewhere, method_of
from glsplat.extras.evaluate.comparison.participant import Participant, participants_in
from glsplat.extras.evaluate.comparison.protocol import Protocol
from glsplat.extras.evaluate.comparison.work import Result, Task, finished, run_tasks, work
from glsplat.formats import load, save

pytestmark = pytest.mark.usefixtures("no_lpips", "strangers")
quiet = lambda step, done: None  # noqa: E731
TWO = ("itself", "smaller")


def tasks_of(people: list[Participant], protocol: Protocol, out: Path, *methods: str) -> list[Task]:
    return [Task(one, dict(method_of(name) for name in methods), protocol, out, {"seed": 0}) for one in people]


def table(results: list[Result], *methods: str) -> str:
    made = [tables.summary(results, methods, 2), tables.by_view(results, methods), tables.by_part(results, methods)]
    return json.dumps([*made, tables.compared(results, methods, 0)])


@pytest.fixture(scope="module")
def whole(people, short, no_lpips, strangers, tmp_path_factory) -> tuple[Path, list[Result]]:
    """Two methods of two people, at once."""
    out = tmp_path_factory.mktemp("whole")
    return out, [r for task in tasks_of(people[:2], short, out, *TWO) for r in work(task, quiet)]


@pytest.mark.check
def test_a_perfect_avatar_is_nearly_perfect_and_a_small_one_is_not(whole) -> None:
    out, results = whole
    assert not [r.failed for r in results if r.failed]
    rows = {(row["method"], row["control"]): row for row in tables.summary(results, TWO, 2)}
    best, worse = rows["itself", "pose"], rows["smaller", "pose"]
    assert best["overlap"]["mean"] > 0.94 and best["psnr"]["mean"] > 27 and best["n"] == best["of"] == 2
    assert rows["itself", "tracking"]["overlap"]["mean"] < best["overlap"]["mean"]
    assert worse["overlap"]["mean"] < 0.9 and worse["l1"]["mean"] > 2 * best["l1"]["mean"]
    by_hand = np.mean([r.data["values"]["pose"]["l1"] for r in results if r.method == "smaller"], axis=(1, 2, 3))
    assert worse["l1"]["mean"] == pytest.approx(by_hand.mean(), abs=1e-6)
    assert worse["l1"]["sd"] == pytest.approx(by_hand.std(ddof=1), abs=1e-6)
    for method in TWO:
        assert (out / "sheets" / method / "p02.jpg").read_bytes().startswith(b"\xff\xd8")


def test_results_hold_for_their_files_and_protocol_alone(people, tmp_path) -> None:
    short = Protocol(tasks=("standing",), views=("left",), size=64, light="none")  # a view that is no front
    folder, made = tmp_path / "people", tmp_path / "mine"
    folder.mkdir()
    made.mkdir()
    shutil.copy(people[1].mesh_file, folder / "one.npz")
    shutil.copy(people[1].mesh_file, made / "one.npz")
    task = tasks_of(participants_in(folder), short, tmp_path / "out", f"mine={made}")[0]
    assert finished(task) == []
    (good,) = work(task, quiet)
    assert not good.failed and len(finished(task)) == 1
    other = Protocol(tasks=short.tasks, views=("back",), size=64, light="none")
    assert finished(tasks_of(participants_in(folder), other, tmp_path / "out", f"mine={made}")[0]) == []
    shutil.copy(people[0].mesh_file, made / "one.npz")
    assert finished(task) == []
    (worse,) = work(task, quiet)
    assert np.mean(worse.data["values"]["pose"]["l1"]) > 2 * np.mean(good.data["values"]["pose"]["l1"])
    shutil.copy(people[0].mesh_file, folder / "one.npz")
    assert finished(tasks_of(participants_in(folder), short, tmp_path / "out", f"mine={made}")[0]) == []
    (tmp_path / "out" / "sheets" / "mine" / "one.jpg").unlink()
    assert finished(task) == []
    for broken in ("", "[]", '{"key": 1}'):
        (tmp_path / "out" / "results" / "mine" / "one.json").write_text(broken)
        assert finished(task) == []


@pytest.mark.check
def test_what_fails_says_why_and_the_others_count(people, short, tmp_path) -> None:
    folder = tmp_path / "people"
    folder.mkdir()
    shutil.copy(people[1].mesh_file, folder / "good.npz")
    (folder / "broken.npz").write_bytes(people[1].mesh_file.read_bytes()[:5000])
    names = ("itself", "raising", "nothing")
    results = [
        r for task in tasks_of(participants_in(folder), short, tmp_path / "out", *names) for r in work(task, quiet)
    ]
    why = {(r.participant, r.method): r.failed for r in results}
    assert len(results) == 6 and why["good", "itself"] == ""
    assert why["good", "raising"] == 'the method "raising" failed on good: ValueError: no idea'
    assert "not an avatar" in why["good", "nothing"] and "broken.npz" in why["broken", "itself"]
    assert not any("\n" in line for line in why.values())
    (row,) = [row for row in tables.summary(results, ("itself",), 2) if row["control"] == "pose"]
    assert (row["n"], row["of"]) == (1, 2) and row["l1"]["sd"] is None
    assert {row["method"] for row in tables.failures(results)} == set(names)
    rows = tables.by_participant(results, names)
    said = [row.get("failed", "") for row in rows if row["participant"] == "good"]
    assert said == ["", why["good", "raising"], why["good", "nothing"]]
    (empty,) = [row for row in tables.summary(results, ("raising",), 2) if row["control"] == "pose"]
    assert empty["n"] == 0 and empty["l1"] is None


@pytest.mark.check
def test_a_folder_of_files_is_a_method(people, short, tmp_path) -> None:
    from glsplat.data import default_avatar

    made = tmp_path / "mine"
    made.mkdir()
    save(default_avatar(), made / f"{people[0].name}.glb")
    splats = load(made / f"{people[0].name}.glb").splats
    save(splats, made / f"{people[1].name}.ply")
    name, source = method_of(f"mine={made}")
    assert isinstance(source, MadeElsewhere)
    results = [r for one in people[:3] for r in work(Task(one, {name: source}, short, tmp_path / "out"), quiet)]
    facts = results[0].data["product"]
    assert (facts["kind"], facts["count"], facts["seconds"]) == ("splats", len(splats), None)
    assert "cm from the mesh" in results[1].failed  # another person's splats
    assert "no file of p05" in results[2].failed


@pytest.mark.check
def test_other_processes_report_results_failures_and_their_end(people, short, tmp_path) -> None:
    what = zip(people, ("raising", "dying", "raising"), strict=False)
    tasks = [Task(one, {method: method}, short, tmp_path) for one, method in what]
    seen = []
    results = [r for some in run_tasks(tasks, 2, lambda index, step, done: seen.append((index, step))) for r in some]
    why = {r.participant: r.failed for r in results}
    assert len(results) == 3 and "no idea" in why["p01"] and "no idea" in why["p05"]
    assert why["p02"] == "the process that worked on p02 ended (exit code 7); memory may have run out"
    assert (2, "p05: raising") in seen


def test_words_of_the_command_line(tmp_path) -> None:
    assert method_of("photo") == ("photo", "photo")
    assert method_of(f"a-b_1={tmp_path}") == ("a-b_1", MadeElsewhere(tmp_path))
    for word, message in (
        ("nobody", 'no method is called "nobody"'),
        ("../x=.", "letters, digits"),
        ("x=/nowhere", "no such folder"),
    ):
        with pytest.raises(GlsplatError, match=message):
            method_of(word)


def test_participants_are_found_by_their_files(tmp_path) -> None:
    with pytest.raises(FormatError, match="no such folder"):
        participants_in(tmp_path / "none")
    with pytest.raises(FormatError, match="nobody is here"):
        participants_in(tmp_path)
    (tmp_path / "ann.npz").write_bytes(b"PK")
    (ann,) = participants_in(tmp_path)
    assert (ann.name, ann.height, ann.camera, ann.pose, ann.light, ann.video) == ("ann", None, None, None, None, None)
    with pytest.raises(FormatError, match=r"capture/ann\.jpg: no such picture"):
        ann.photo  # noqa: B018
    with pytest.raises(FormatError, match=r"ann\.npz"):
        ann.mesh  # noqa: B018
    (tmp_path / "participants.json").write_text('{"participants": [{"id": "ann", "height_m": 1.7}]}')
    assert participants_in(tmp_path)[0].height == 1.7
    for text in ("[]", "{", '{"participants": [{"id": "ann"}]}', '{"participants": 3}'):
        (tmp_path / "participants.json").write_text(text)
        with pytest.raises(FormatError, match=r"participants\.json"):
            participants_in(tmp_path)


@pytest.mark.check
def test_one_bad_avatar_leaves_its_neighbours_alone(people, short, tmp_path, monkeypatch) -> None:
    add, renderers = working.Stage.add, []

    def broken(cameras, pose):
        raise ZeroDivisionError("nothing to see")

    def adding(stage, figure):
        renderers.append(add(stage, figure))
        if len(renderers) == 1:
            renderers[0].render = broken
        return renderers[-1]

    monkeypatch.setattr(working.Stage, "add", adding)
    (task,) = tasks_of(people[1:2], short, tmp_path, "itself", "smaller")
    results = {result.method: result.failed for result in work(task, quiet)}
    assert results == {"itself": "ZeroDivisionError: nothing to see", "smaller": ""}
