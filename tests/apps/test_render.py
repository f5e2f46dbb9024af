"""``glsplat render``: views, poses, sequences, and the mistakes a first user makes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps.cli import joined, main
from glsplat import reference
from glsplat.formats import save
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from tests.compare import assert_contract
from tests.scenes import camera, cloud, eyes, limb, one_splat
from tests.skinning.faces import expressive

pytestmark = pytest.mark.gl

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    save(cloud(300, 1), tmp_path / "cloud.ply")
    return tmp_path / "cloud.ply"


@pytest.fixture
def avatar(tmp_path: Path) -> Path:
    save(limb(400), tmp_path / "limb.glb")
    return tmp_path / "limb.glb"


def fails(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line a failing command prints."""
    code = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    assert code == (2 if err.endswith("--help\n") else 1)  # bad usage says where help is
    assert out == "" and err.count("\n") == 1 and "Traceback" not in err
    return err


def test_an_expression_moves_the_face(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    avatar, view = expressive(400), tmp_path / "view.json"
    save(avatar, tmp_path / "face.glb")
    view.write_text(json.dumps(camera(48, 2.5).to_json()))
    out = tmp_path / "out.npy"
    common = ["render", str(tmp_path / "face.glb"), "--cameras", str(view), "-o", str(out)]
    assert main([*common, "--expression", "jawOpen=0.7,eyeBlinkLeft=1"]) == 0
    pose = Pose(np.zeros((4, 3)), expression={"jawOpen": 0.7, "eyeBlinkLeft": 1.0})
    bones, weights = pose.bones(avatar.skeleton), avatar.weights(pose)
    wanted = reference.render(
        avatar.splats, [camera(48, 2.5)], avatar.skin, bones, shapes=avatar.shapes, expression=weights
    )
    assert_contract(np.load(out)[None], wanted)
    (tmp_path / "pose.json").write_text(json.dumps({"joints": {}, "expression": {"jawOpen": 0.7, "eyeBlinkLeft": 0.1}}))
    assert main([*common, "--pose", str(tmp_path / "pose.json"), "--expression", "eyeBlinkLeft=1"]) == 0
    assert_contract(np.load(out)[None], wanted)
    assert "no shape 'cheekPuff'; it has jawOpen, eyeBlinkLeft" in fails(capsys, *common, "--expression", "cheekPuff=1")
    for bad in ("jawOpen=wide", "jawOpen=nan", "jawOpen=1,jawOpen=0", ""):
        with pytest.raises(SystemExit):
            main([*common, "--expression", bad])
        assert "NAME=WEIGHT" in capsys.readouterr().err
    save(limb(50), tmp_path / "face.glb")
    assert "this one has none" in fails(capsys, *common, "--expression", "jawOpen=1")


def test_camera_files(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, pair = tmp_path / "one.json", tmp_path / "pair.json"
    one.write_text(json.dumps(camera(48).to_json()))
    pair.write_text(json.dumps([c.to_json() for c in eyes(48)]))
    for cameras, views, shape in ((one, [camera(48)], (48, 48, 4)), (pair, eyes(48), (2, 48, 48, 4))):
        assert main(["render", str(scene), "--cameras", str(cameras), "-o", str(tmp_path / "out.npy"), "--json"]) == 0
        image = np.load(tmp_path / "out.npy")
        assert image.shape == shape and image.dtype == np.float32
        assert_contract(image.reshape(-1, 48, 48, 4), reference.render(cloud(300, 1), views))
        report = json.loads(capsys.readouterr().out)
        assert report["splats"] == 300 and report["drawn"] + sum(report["culled"].values()) == 300
        assert {"project", "draw", "read", "total"} <= set(report["timings_ms"])
        assert report["variant"]["views"] == len(views) and report["driver"] and report["backend"]


def test_view_options_and_png(scene: Path, tmp_path: Path) -> None:
    view = ["--size", "40x30", "--fov", "50", "--eye", "0,0,3", "--target", "0,0,0"]
    assert main(["render", str(scene), *view, "--stereo", "--ipd", "0.5", "-o", str(tmp_path / "a.png")]) == 0
    picture = cv2.imread(str(tmp_path / "a.png"))
    assert picture.shape == (30, 80, 3) and np.abs(picture[:, :40].astype(int) - picture[:, 40:]).max() > 20


def test_poses_and_motions(avatar: Path, tmp_path: Path) -> None:
    (tmp_path / "p.json").write_text(json.dumps({"joints": {"joint1": [0, 0, 1.2]}, "trans": [-0.5, 0, 0]}))
    view = ["--size", "48", "--eye", "0,0,3", "--target", "0,0,0"]
    assert main(["render", str(avatar), *view, "-o", str(tmp_path / "a.npy")]) == 0
    assert main(["render", str(avatar), *view, "--pose", str(tmp_path / "p.json"), "-o", str(tmp_path / "b.npy")]) == 0
    straight, bent = np.load(tmp_path / "a.npy"), np.load(tmp_path / "b.npy")
    assert np.abs(straight - bent).max() > 0.2


@pytest.mark.parametrize("output", ["clip.mp4", "frames/"])
def test_turntable(scene: Path, tmp_path: Path, output: str) -> None:
    target = str(tmp_path) + "/" + output
    assert main(["render", str(scene), "--size", "32x32", "--turntable", "5", "-o", target]) == 0
    if output == "clip.mp4":
        clip = cv2.VideoCapture(target)
        assert int(clip.get(cv2.CAP_PROP_FRAME_COUNT)) == 5
        clip.release()
    else:
        names = sorted(p.name for p in Path(target).iterdir())
        assert names == [f"{i:05d}.png" for i in range(5)]
        first, third = (cv2.imread(f"{target}{names[i]}") for i in (0, 2))
        assert np.abs(first.astype(int) - third).max() > 20


def test_a_motion_of_the_default_avatar(tmp_path: Path) -> None:
    for frame in ("0", "30"):
        out = str(tmp_path / f"{frame}.png")
        assert main(["render", "--motion", "walk", "--frame", frame, "--size", "64", "-o", out]) == 0
    a, b = (cv2.imread(str(tmp_path / f"{f}.png")).astype(int) for f in ("0", "30"))
    assert a.any() and np.abs(a - b).max() > 30


def test_wrong_inputs(scene: Path, avatar: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    png = tmp_path / "x.png"
    text = tmp_path / "notes.txt"
    text.write_text("no splats here")
    bad = tmp_path / "bad.json"
    cases = [
        ([tmp_path / "none.ply", "-o", png], "none.ply: no such file"),
        ([text, "-o", png], "notes.txt: expected 3DGS PLY"),
        ([scene, "-o", tmp_path / "x.jpg"], "expected .png or .npy"),
        ([scene, "-o", tmp_path / "no" / "x.png"], "there is no folder"),
        ([scene, "--pose", "p.json", "-o", png], "no skeleton"),
        ([avatar, "--pose", tmp_path / "p.json", "-o", png], "cannot read the pose"),
        ([avatar, "--pose", "a", "--motion", "b", "-o", png], "not both"),
        ([scene, "--device", "nothing", "-o", png], "no EGL device 'nothing'; there are 0: "),
        ([scene, "--size", "100000x4", "-o", png], "size needs 1 to "),
        ([scene, "--eye", "1,1,1", "--target", "1,1,1", "-o", png], "the same point"),
        ([scene, "--frame", "1", "-o", png], "--frame needs --motion"),
        ([scene, "--cameras", "c.json", "--stereo", "-o", png], "--cameras or --stereo"),
        ([avatar, "--turntable", "2", "--motion", "m", "-o", tmp_path / "x.mp4"], "needs --frame"),
        ([scene, "--turntable", "2", "-o", f"{tmp_path}/missing/frames/"], "there is no folder"),
        ([scene, "--size", "1", "--turntable", "2", "-o", tmp_path / "x.mp4"], "at least 2x2"),
        ([scene, "--turntable", "0", "-o", tmp_path / "x.mp4"], "at least 1 view"),
        ([scene, "--cameras", tmp_path / "no.json", "-o", png], "cannot read the camera file"),
    ]
    for arguments, expected in cases:
        assert expected in fails(capsys, "render", *arguments)
    for content, expected in (
        ("{", "is JSON"),
        ("[]", "at least one camera"),
        ("{}", "missing width, height"),
        ('{"width": 1.5, "height": 2, "fx": 1, "fy": 1, "w2c": []}', "width needs a whole number"),
        (json.dumps({**camera(8).to_json(), "w2c": np.eye(3).tolist()}), "4x4 matrix"),
        (
            json.dumps({**camera(8).to_json(), "w2c": [[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}),
            "rotation",
        ),
        (json.dumps({**camera(8).to_json(), "fx": "100"}), "fx needs a finite number, not '100'"),
        (json.dumps({**camera(8).to_json(), "width": True}), "width needs a whole number"),
        (json.dumps({**camera(8).to_json(), "bg": "123"}), "bg needs 3 numbers"),
        (json.dumps({**camera(8).to_json(), "bg": [1e200, 0, 0]}), "three finite numbers"),
        (json.dumps({**camera(8).to_json(), "sh_degree": 1.7}), "sh_degree needs a whole number"),
        (json.dumps({**camera(8).to_json(), "fx": 1e300}), "below 1e+12"),
        (json.dumps({**camera(8).to_json(), "fx": -1}), "fx, fy > 0"),
        (json.dumps({**camera(8).to_json(), "near": 0}), "near"),
        (json.dumps([camera(8).to_json(), camera(9).to_json()]), "same width and height"),
    ):
        bad.write_text(content)
        assert expected in fails(capsys, "render", scene, "--cameras", bad, "-o", png)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.json", "cloud.ply", "limb.glb", "notes.txt"]


def test_strict_refuses_nan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(one_splat(means=[[np.nan, 0, 0]]), tmp_path / "nan.ply")
    assert main(["render", str(tmp_path / "nan.ply"), "--size", "8", "-o", str(tmp_path / "a.png"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["skipped"] == 1
    assert "1 of 1 splats" in fails(capsys, "render", tmp_path / "nan.ply", "--strict", "-o", tmp_path / "b.png")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_unwritable_output(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    assert "cannot be written" in fails(capsys, "render", scene, "--size", "8", "-o", folder / "x.png")


def test_output_that_is_a_folder_leaves_nothing(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken.png").mkdir()
    assert "this is a folder" in fails(capsys, "render", scene, "--size", "8", "-o", tmp_path / "taken.png")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cloud.ply", "taken.png"]


def test_usage_errors_exit_with_2(scene: Path) -> None:
    wrong = (["--size", "axb"], ["--fov", "200"], ["--fov", "nan"], ["--fps", "0"], ["--eye", "1,2"], ["--size", "0x4"])
    for arguments in (["render", str(scene)], ["nonsense"], *(["render", "-o", "x.png", *w] for w in wrong)):
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        assert stop.value.code == 2


def test_a_point_may_begin_with_a_minus(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As an argument of its own, with =, and with .5; what follows is still read, and after -- nothing is joined."""
    shots = []
    for index, eye in enumerate((["--eye", "-1.2,1,-2"], ["--eye=-1.2,1,-2"], ["--eye", "-1.20,1e0,-.2e1"])):
        png = tmp_path / f"{index}.npy"
        arguments = ["render", str(scene), *eye, "--target", "-.1,0,0", "--size", "24", "-o", str(png)]
        assert main(arguments) == 0
        shots.append(np.load(png))
    assert np.array_equal(shots[0], shots[1]) and np.array_equal(shots[0], shots[2])
    assert joined(["--eye", "-1,2,3", "--", "--eye", "-1"]) == ["--eye=-1,2,3", "--", "--eye", "-1"]
    assert joined(["-o", "-1.png", "--json", "--size", "8", "-2"]) == ["-o", "-1.png", "--json", "--size", "8", "-2"]
    with pytest.raises(SystemExit):
        main(["render", str(scene), "--eye", "-1,2", "-o", str(tmp_path / "a.png")])
    assert "a point is x,y,z, for example 0,1,3, not '-1,2'" in capsys.readouterr().err


def test_empty_scene(tmp_path: Path) -> None:
    empty = cloud(1).take(np.zeros(0, int))
    assert isinstance(empty, Splats)
    save(empty, tmp_path / "empty.ply")
    assert main(["render", str(tmp_path / "empty.ply"), "--size", "8", "-o", str(tmp_path / "a.png")]) == 0


def test_suffix_in_capitals_and_one_camera_in_a_list(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "list.json").write_text(json.dumps([camera(16).to_json()]))
    arguments = ["render", str(scene), "--cameras", str(tmp_path / "list.json"), "-o", str(tmp_path / "a.NPY")]
    assert main(arguments) == 0
    assert np.load(tmp_path / "a.NPY").shape == (1, 16, 16, 4)


def test_a_clip_that_does_not_fit_on_the_disk_is_not_published(scene: Path, tmp_path: Path) -> None:
    script = "import sys; from apps.cli import main; sys.exit(main(sys.argv[1:]))"
    command = (
        f"ulimit -f 8; exec {sys.executable} -c '{script}' render {scene} --size 256 --turntable 20 -o {tmp_path}/a.mp4"
    )
    done = subprocess.run(["bash", "-c", command], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1 and "a.mp4" in done.stderr and "Traceback" not in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cloud.ply"]


def test_a_full_disk_behind_standard_output(scene: Path) -> None:
    script = "import sys; from apps.cli import main; sys.exit(main(sys.argv[1:]))"
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-c", script, "inspect", str(scene)]
        done = subprocess.run(command, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1 and done.stderr.startswith("glsplat inspect: No space left")
