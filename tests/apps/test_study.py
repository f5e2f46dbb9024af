"""``glsplat study`` from the command line: the whole way but for the session, and one line for each mistake."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from apps.cli import main
from apps.serve.agreed import policy_of
from apps.serve.study import study_of
from glsplat.extras.study.plan import label
from glsplat.extras.study.store import Store
from glsplat.formats import load_scene
from tests.apps.cli import serving
from tests.extras.study.designs import SMALL, write
from tests.extras.study.test_session import Walk

ROOT = Path(__file__).resolve().parents[2]


def test_the_way(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path)
    assert main(["study", "check", str(path)]) == 0
    assert "6 participants, 2 conditions" in capsys.readouterr().out
    assert main(["study", "plan", str(path)]) == 0
    assert capsys.readouterr().out.count("fast, slow") == 3
    assert main(["study", "plan", str(path)]) == 1
    assert "not overwritten" in capsys.readouterr().err
    walk = Walk(tmp_path)
    walk.to("rest")
    store = Store(tmp_path / "data", 1)
    store.append(walk.log)
    store.close()
    assert main(["study", "export", str(path), "-o", str(tmp_path / "tables")]) == 0
    out = capsys.readouterr().out
    assert "scores.csv: 4 rows" in out and "sub-001: under way" in out
    with open(tmp_path / "tables" / "scores.csv", newline="") as file:
        assert {row["participant"] for row in csv.DictReader(file)} == {"sub-001"}
    assert main(["study", "delete", str(path), "1"]) == 2
    assert (tmp_path / "data" / label(1)).exists() and "--yes" in capsys.readouterr().err
    assert main(["study", "delete", str(path), "1", "--yes"]) == 0
    assert not (tmp_path / "data" / label(1)).exists()
    assert main(["study", "delete", str(path), "1", "--yes"]) == 1
    path.write_text(SMALL.replace("latency = 150", "latency = 10"))
    capsys.readouterr()
    assert main(["study", "export", str(path), "-o", str(tmp_path / "tables")]) == 1
    assert "conditions 2.latency has changed" in capsys.readouterr().err


def test_a_new_folder_says_what_it_lacks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "lab"
    assert main(["study", "new", str(folder), "--paper"]) == 0
    path = folder / "study.toml"
    assert main(["study", "check", str(path), "--participant", "7"]) == 1
    out = capsys.readouterr().out
    assert "no text yet: veq.vbo1" in out and "sub-007-self-ours.glb" in out and "sub-008" not in out
    assert main(["study", "plan", str(path)]) == 1
    assert "30 items have no text yet" in capsys.readouterr().err
    path.write_text("mine")
    assert main(["study", "new", str(folder)]) == 0
    assert path.read_text() == "mine" and "stays as it is" in capsys.readouterr().out


def test_a_new_study_runs_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is missing, both avatars are there and shown without a consent of their own."""
    assert main(["study", "new", str(tmp_path)]) == 0
    design = tmp_path / "study.toml"
    assert main(["study", "check", str(design)]) == 0
    assert "no text yet" not in (out := capsys.readouterr().out) and "no such avatar" not in out
    assert main(["study", "plan", str(design)]) == 0
    served = study_of(serving(f"study={design}", "participant=2"))
    names = [path.name for path in (Path(served.options.scene or ""), *served.options.avatar)]
    assert sorted(names) == ["anna.glb", "ben.glb"]
    policy_of(served.options, load_scene(served.options.scene), "anna")


def test_texts_of_a_dropped_questionnaire_say_what_to_delete(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path)
    path.write_text(path.read_text() + "\n[text.veq]\n")
    assert main(["study", "check", str(path)]) == 1
    assert "[text.veq] is for a questionnaire that the study does not have; delete it" in capsys.readouterr().err


def test_check_says_what_an_analysis_will_lack(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A forgotten condition, and groups that cannot be of one size, while they can still be helped."""
    path = write(tmp_path)
    assert main(["study", "check", str(path)]) == 0
    assert "no condition has" not in (out := capsys.readouterr().out) and "not balanced" not in out
    assert "not within each group: that takes a multiple of 4" in out  # two rows, two groups, six people
    levels = 'delay = ["none", "some", "much"]'
    path.write_text(SMALL.replace('delay = ["none", "some"]', levels).replace("participants = 6", "participants = 5"))
    assert main(["study", "check", str(path)]) == 0
    out = capsys.readouterr().out
    assert "no condition has delay = much:" in out and "no multiple of 2, the groups" in out


@pytest.mark.check
@pytest.mark.gl
def test_run_is_a_server(tmp_path: Path) -> None:
    """Two links as JSON; the second server for the same participant is refused; SIGTERM ends it in order."""
    path = write(tmp_path)
    assert main(["study", "plan", str(path)]) == 0
    words = [sys.executable, "-m", "apps.cli", "study", "run", str(path), "1", "--port", "0", "--json"]
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        assert ready["study"]["participant"].endswith("/vr/study.html")
        assert ready["study"]["experimenter"].endswith("/vr/watch.html")
        secrets = json.loads(Path(ready["study"]["keys"]).read_text())
        assert not any(secret in json.dumps(ready) for secret in secrets.values())  # outputs are kept in logs
        second = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=60)
        assert second.returncode == 1 and "another process holds it" in second.stderr
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
