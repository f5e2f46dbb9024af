"""Avatars that no motion and no tracking can drive: every command says so before it does anything, in one line."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np
import pytest

from apps.cli import main
from apps.serve import command as serve
from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.formats import load, save
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.apps.cli import serving
from tests.apps.conftest import Stripes, running
from tests.formats.scenes import random_avatar

OTHER = "its joints are another rig's (pelvis is mixamorig:Hips, ...); glsplat avatar import puts it on the 55"


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder with an avatar of five joints and splats without any."""
    save(random_avatar(20), tmp_path / "five.glb")
    save(random_avatar(20).splats, tmp_path / "cloud.ply")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def mixamo(every: int = 400) -> Avatar:
    """The default avatar with the names that Mixamo gives, its bones pointing along limbs as there."""
    person = default_avatar()
    pick = np.arange(0, len(person.splats), every)
    words = {
        "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head",
        "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase", "collar": "Shoulder", "shoulder": "Arm",
        "elbow": "ForeArm", "wrist": "Hand",
    }  # fmt: skip
    names = []
    for name in person.skeleton.names:
        side, _, part = name.rpartition("_")
        own = words.get(part if side else name)
        names.append(f"mixamorig:{side.capitalize()}{own}" if own else f"extra_{len(names)}")
    rest = person.skeleton.rest.copy()
    rest[:, :3, :3] = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]  # x along y: not parallel to the world
    return Avatar(person.splats.take(pick), Skeleton(names, person.skeleton.parents, rest), person.skin.take(pick))


def but_the_gate(err: str) -> list[str]:
    """Return the lines, without the one that says that the machine is busy."""
    return [line for line in err.splitlines() if "not a quiet machine" not in line]


@pytest.mark.extra(name="consent")
@pytest.mark.extra(name="evaluate")
@pytest.mark.gl
def test_bench_measures_what_stands_and_says_so(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "five.glb", "--sizes", "16", "--frames", "3", "--json"]) == 0
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert [row["kind"] for row in result["settings"]] == ["static"]
    assert err.startswith("glsplat bench: five.glb: wave-and-turn cannot drive this avatar: no joint for head")
    (line,) = but_the_gate(err)
    assert line.endswith("measured standing still")
    assert main(["bench", "five.glb", "--sizes", "16", "--frames", "3", "--json", "--static"]) == 0
    assert not but_the_gate(capsys.readouterr().err)  # nothing else was asked for
    for words, text in ((["five.glb"], "by no motion: no joint for head"), ([], "by motions and headsets")):
        assert main(["inspect", *words]) == 0
        assert f"driven       {text}" in capsys.readouterr().out


@pytest.mark.extra(name="authoring")
def test_an_avatar_of_another_rig_is_put_onto_smplx(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(mixamo(), files / "soldier.glb")
    assert main(["render", "soldier.glb", "--motion", "walk", "--frame", "3", "-o", "out.png"]) != 0
    assert OTHER in capsys.readouterr().err
    assert main(["avatar", "import", "soldier.glb", "-o", "me.glb"]) == 0
    made, person = load("me.glb"), default_avatar()
    assert isinstance(made, Avatar) and made.skeleton.names == JOINT_NAMES
    body = [JOINT_NAMES.index(name) for name in made.meta["rig"]]
    assert len(body) == 22 and made.meta["rig"]["left_wrist"] == "mixamorig:LeftHand"
    assert np.abs(made.skeleton.joints[body] - person.skeleton.joints[body]).max() < 0.03
    assert not np.abs(made.skeleton.rest[:, :3, :3] - np.eye(3)).max()
    # the same person in the same pose: no splat that rides the trunk or an arm is elsewhere
    turned = np.zeros((55, 3))
    turned[[16, 18, 1, 4]] = [[0, 0, -1], [0, -0.5, 0], [-0.8, 0, 0], [0.6, 0, 0]]
    means = []
    for avatar in (made, Avatar(person.splats, person.skeleton, person.skin)):
        bones = Pose(turned).bones(avatar.skeleton)[avatar.skin.joints]
        blended = np.einsum("nk,nkij->nij", avatar.skin.weights, bones)
        means.append(np.einsum("nij,nj->ni", blended[:, :, :3], avatar.splats.means) + blended[:, :, 3])
    apart = np.linalg.norm(means[0] - means[1][::400], axis=1)
    assert np.percentile(apart, 90) < 0.03 and len(apart) == 100
    assert main(["tracking", "calibrate", "--height", "1.7", "--avatar", "me.glb", "-o", "c.json"]) == 0


@pytest.mark.extra(name="authoring")
def test_import_with_a_map_and_without_sense(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    avatar = mixamo()
    names = [name if "UpLeg" not in name else f"b{k}" for k, name in enumerate(avatar.skeleton.names)]
    skeleton = Skeleton(names, avatar.skeleton.parents, avatar.skeleton.rest)
    save(Avatar(avatar.splats, skeleton, avatar.skin), files / "odd.glb")
    assert main(["avatar", "import", "odd.glb", "-o", "me.glb"]) == 1
    assert "odd.glb: this avatar cannot be put onto SMPL-X's joints: no joint for left_hip" in capsys.readouterr().err
    (files / "map.json").write_text(json.dumps({"left_hip": "b1", "right_hip": "b2"}))
    assert main(["avatar", "import", "odd.glb", "--rig-map", "map.json", "-o", "me.glb"]) == 0
    capsys.readouterr()
    for words, text in (
        (["me.glb", "-o", "again.glb"], "me.glb: this avatar has the 55 joints of SMPL-X already"),
        (["five.glb", "--rig-map", "map.json", "-o", "x.glb"], 'gives left_hip a joint "b1", which this avatar'),
    ):
        assert main(["avatar", "import", *words]) == 1
        assert text in capsys.readouterr().err


def test_replay_prints_no_figures_of_what_stands_still(capsys: pytest.CaptureFixture[str]) -> None:
    """Poses to a scene without a skeleton, tracking to another rig: told before any table, and once."""
    with running(Stripes(), still="it has no skeleton", untracked="it has no skeleton") as url:
        for drive, text in (
            (["walk"], "the server does not apply poses: it has no skeleton"),
            ([], "tracking solver for what it"),
        ):
            assert main(["replay", *drive, "--url", url, "--frames", "30", "--size", "64"]) == 1
            out, err = capsys.readouterr()
            assert out == "" and text in err and err.count("\n") == 1


@pytest.mark.extra(name="consent")
@pytest.mark.parametrize("name", ["five.glb", "cloud.ply"])
def test_a_server_says_it_before_it_listens(
    files: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    text = {
        "five.glb": "motions and tracking are not applied: no joint for head, left_hip",
        "cloud.ply": "poses and tracking are not applied: it has no skeleton; clients move the camera",
    }[name]

    class StopError(Exception): ...

    async def run(*args: object) -> None:
        raise StopError

    monkeypatch.setattr("glsplat.net.server.Server.run", run)
    monkeypatch.setattr("apps.serve.command.start_logging", lambda *args: None)
    with caplog.at_level(logging.WARNING), pytest.raises(StopError):
        serve.run(serving(name, "without-consent=true"))
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith(f'"{Path(name).stem}": ') and text in line
