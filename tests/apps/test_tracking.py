"""The tracking command: every task once, and its errors."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources

import cv2
import numpy as np
import pytest

from apps import cli
from apps.tracking.bench import table
from apps.tracking.show import BONE, NAIVE, TRUE
from glsplat.extras.evaluate.tracking_score import Row, TrackingScore
from glsplat.extras.learned.network import load_network

nan = float("nan")
SCORE = TrackingScore(600, *[1.0] * 13)


def run(*words) -> int:
    return cli.main(["tracking", *map(str, words)])


@pytest.fixture(scope="module")
def derived(tmp_path_factory):
    tmp_path = tmp_path_factory.mktemp("derived")
    assert run("from-motion", "idle", "-o", tmp_path / "r.jsonl", "--truth", tmp_path / "t.jsonl", "--rate", 30) == 0
    return tmp_path


def test_derive_solve_score(derived, capsys):
    assert run("solve", derived / "r.jsonl", "-o", derived / "p.jsonl") == 0
    line = json.loads((derived / "p.jsonl").read_text().splitlines()[5])
    assert set(line) >= {"t", "trans", "root_pose", "body_pose", "lhand_pose", "joints", "reach_error", "flags"}
    assert np.shape(line["joints"]) == (55, 3) and len(line["reach_error"]) == 2 and "left_planted" in line["flags"]
    capsys.readouterr()
    assert run("score", derived / "p.jsonl", derived / "t.jsonl", "--json") == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["mpjpe"] < 3 and scores["hands"] < 0.5 and scores["mpjre"] < 8
    assert run("score", derived / "p.jsonl", derived / "t.jsonl") == 0
    assert "MPJPE" in capsys.readouterr().out
    assert run("solve", derived / "r.jsonl", "-o", derived / "p.jsonl", "--head-only", "--no-filter") == 0
    assert json.loads((derived / "p.jsonl").read_text().splitlines()[0])["reach_error"] is None


def test_trackers_of_a_motion_are_calibrated_and_solved(tmp_path, capsys):
    words = ("--noise-mm", 3, "--noise-deg", 1, "--dropout", 0.3, "--latency-ms", 50, "--seconds", 2, "--no-fingers")
    assert run("from-motion", "wave-and-turn", "-o", tmp_path / "r.jsonl", *words) == 0  # disturbed
    lines = [json.loads(line) for line in (tmp_path / "r.jsonl").read_text().splitlines()]
    assert 130 < len(lines) < 150 and any(line["left"] is None for line in lines) and "left_joints" not in lines[0]
    words = ("--rate", 30, "--trackers", "waist, feet,body", "--truth", tmp_path / "t.jsonl")
    assert run("from-motion", "idle", "-o", tmp_path / "r.jsonl", *words) == 0
    line = json.loads((tmp_path / "r.jsonl").read_text().splitlines()[3])
    assert {"waist", "left_foot", "right_foot"} <= set(line) and len(line["body"]) == 10
    assert run("calibrate", tmp_path / "r.jsonl", "-o", tmp_path / "c.json") == 0
    assert "trackers: waist, left_foot, right_foot" in capsys.readouterr().out
    words = ("--calibration", tmp_path / "c.json", "-o", tmp_path / "p.jsonl")
    assert run("solve", tmp_path / "r.jsonl", *words) == 0
    capsys.readouterr()
    assert run("score", tmp_path / "p.jsonl", tmp_path / "t.jsonl", "--json") == 0
    assert json.loads(capsys.readouterr().out)["lower"] < 4  # how the feet stood while calibrating is not known better


def test_show_draws_a_window_of_a_motion_beside_its_truth_and_the_naive_baseline(tmp_path, capsys):
    words = ("--motion", "wave-and-turn", "--rate", 30, "--from", 1, "--seconds", 1, "--stick", "--size", "160x120")
    assert run("show", "-o", tmp_path / "sheet.png", *words) == 0
    sheet = cv2.imread(str(tmp_path / "sheet.png"))[..., ::-1].astype(int)
    for colour in (BONE, TRUE, NAIVE):
        assert (np.abs(sheet - colour).max(-1) < 40).any()
    assert run("show", "-o", f"{tmp_path}/frames/", *words, "--fps", 30) == 0
    assert sorted(path.stem for path in (tmp_path / "frames").iterdir())[:2] == ["000030", "000031"]
    assert run("show", "-o", tmp_path / "clip.mp4", *words, "--fps", 10) == 0
    assert (tmp_path / "clip.mp4").stat().st_size > 1000


def test_bench_names_the_windows_that_are_worse_than_naive():
    rows = [Row("clip", 30.0, solver, SCORE, nan, windows) for solver, windows in
            (("glued", (9.0, 9.0)), ("naive", (5.0, 5.0)), ("naive, untold", (8.0, 8.0)), ("analytic", (6.0, 6.0)),
             ("learned", (6.9, 7.1)), ("learned, head only", (20.0, 20.0)))]  # fmt: skip
    text = table(rows, files={"clip": "a folder/clip.bvh"})
    worst = [line for line in text.splitlines() if line.startswith("- ")]
    assert len(worst) == 1 and "from 10.0 s: 7.1 cm, naive 5.0" in worst[0]
    assert "glsplat tracking show --motion 'a folder/clip.bvh' --rate 30 --from 10.0 --seconds 10.0" in worst[0]
    assert "none." in table([row for row in rows if row.solver != "learned"] + [replace(rows[4], windows=(6.9, 6.9))])


@pytest.mark.check
@pytest.mark.gl
def test_show_draws_the_avatar(derived):
    assert run("show", derived / "r.jsonl", "-o", derived / "sheet.png", "--size", "128x128") == 0
    sheet = cv2.imread(str(derived / "sheet.png")).astype(int)
    blue = (sheet[..., 0] > sheet[..., 2] + 40).mean()  # the jumper
    assert blue > 0.02


def test_bench_prints_its_table_or_json(capsys):
    assert run("bench", "idle", "--rates", "30") == 0
    assert "| idle | 30 | learned | " in capsys.readouterr().out
    assert run("bench", "idle", "--rates", "30", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    baselines = ["glued", "naive", "naive, untold"]
    assert [row["solver"] for row in rows] == [*baselines, "analytic", "learned", "learned, head only"]


@pytest.mark.check
def test_train_makes_a_network_that_solves_and_goes_on_learning(tmp_path, capsys):
    clips = tmp_path / "clips"
    clips.mkdir()
    for name in ("walk", "idle"):
        text = (resources.files("glsplat.data") / f"{name}.json").read_text()
        (clips / f"{name}_01.json").write_text(text)
    words = ("--steps", 2, "--units", 8)
    model = tmp_path / "m.npz"
    assert run("train", clips, "-o", model, *words, "--hold-out", "1/2", "--note", "two", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert len(said["left_out"]) == 1 and said["pelvis"] > 0 and 0 <= said["contact"] <= 1
    assert load_network(model).units == 8 and load_network(model).note == "two"
    assert run("train", clips, "-o", tmp_path / "n.npz", *words, "--from", model) == 0
    assert not np.array_equal(load_network(model).cell, load_network(tmp_path / "n.npz").cell)
    assert run("train", clips, "-o", tmp_path / "o.npz", *words, "--from", tmp_path / "none.npz") == 1
    assert "cannot read the tracking model" in capsys.readouterr().err and not (tmp_path / "o.npz").exists()
