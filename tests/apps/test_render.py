"""``glsplat render``: views, poses, sequences, and the mistakes a first user makes."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps.cli import joined, main
from glsplat import reference
from glsplat.extras.speech.sound import Sound, read_wav
from glsplat.formats import save
from glsplat.skinning.pose import Pose
from tests.apps.cli import mistake
from tests.compare import assert_contract
from tests.extras.speech.sounds import wav_bytes
from tests.scenes import camera, cloud, eyes, limb, one_splat
from tests.skinning.faces import expressive

pytestmark = pytest.mark.gl


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    save(cloud(300, 1), tmp_path / "cloud.ply")
    return tmp_path / "cloud.ply"


@pytest.fixture
def avatar(tmp_path: Path) -> Path:
    save(limb(400), tmp_path / "limb.glb")
    return tmp_path / "limb.glb"


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
    for bad in ("jawOpen=wide", "jawOpen=1,jawOpen=0", ""):
        assert "NAME=WEIGHT" in mistake(capsys, *common, "--expression", bad)


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
    one.write_text(json.dumps([camera(16).to_json()]))
    assert main(["render", str(scene), "--cameras", str(one), "-o", str(tmp_path / "a.NPY")]) == 0
    assert np.load(tmp_path / "a.NPY").shape == (1, 16, 16, 4)


def test_views_poses_and_png(avatar: Path, tmp_path: Path) -> None:
    pose, pictures = tmp_path / "p.json", []
    pose.write_text(json.dumps({"joints": {"joint1": [0, 0, 1.2]}, "trans": [-0.5, 0, 0]}))
    view = ["--size", "40x30", "--fov", "50", "--eye", "0,0,3", "--target", "0,0,0", "--stereo", "--ipd", "0.5"]
    for more in ([], ["--pose", str(pose)]):
        assert main(["render", str(avatar), *view, *more, "-o", str(tmp_path / "a.png")]) == 0
        pictures.append(cv2.imread(str(tmp_path / "a.png")).astype(int))
    assert pictures[0].shape == (30, 80, 3) and np.abs(pictures[0][:, :40] - pictures[0][:, 40:]).max() > 20
    assert np.abs(pictures[0] - pictures[1]).max() > 50
    save(cloud(1).take(np.zeros(0, int)), tmp_path / "empty.ply")
    assert main(["render", str(tmp_path / "empty.ply"), "--size", "8", "-o", str(tmp_path / "a.png")]) == 0


def test_strict_refuses_nan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(one_splat(means=[[np.nan, 0, 0]]), tmp_path / "nan.ply")
    assert main(["render", str(tmp_path / "nan.ply"), "--size", "8", "-o", str(tmp_path / "a.png"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["skipped"] == 1
    assert "1 of 1 splats" in mistake(capsys, "render", tmp_path / "nan.ply", "--strict", "-o", tmp_path / "b.png")


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


SPOKEN = Path(__file__).parents[1] / "extras" / "speech" / "data" / "balloon.wav"


@pytest.fixture
def face(tmp_path: Path) -> Path:
    save(expressive(300), tmp_path / "face.glb")
    return tmp_path / "face.glb"


def rendered(face: Path, *words: str) -> int:
    return main(["render", str(face), "--size", "48", "--fps", "10", *words])


def test_a_clip_is_as_long_as_the_sound_and_has_it(
    face: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    av = pytest.importorskip("av")
    out = tmp_path / "a.mp4"
    assert rendered(face, "--speech", str(SPOKEN), "-o", str(out)) == 0
    assert "sound of FLAC" in capsys.readouterr().out
    with av.open(str(out)) as file:
        pictures = [frame.to_ndarray(format="rgb24").astype(int) for frame in file.decode(video=0)]
    with av.open(str(out)) as file:
        sound = np.concatenate([frame.to_ndarray().ravel() for frame in file.decode(audio=0)])
    spoken = read_wav(SPOKEN)
    assert len(pictures) == round(spoken.seconds * 10)
    assert np.array_equal(sound, np.rint(spoken.samples.astype(float) * 32767).astype(np.int16))
    assert max(np.abs(one - pictures[0]).max() for one in pictures) > 20, "the face moves"


def test_sounds_and_faces_that_are_none(face: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.wav").write_bytes(b"RIFF0000WAVE")
    (tmp_path / "slow.wav").write_bytes(wav_bytes(Sound(np.zeros(80, np.float32), 8000)))
    for sound, says in (("a.wav", "without sound"), ("slow.wav", "16000 to 384000")):
        assert says in mistake(capsys, "render", face, "--speech", tmp_path / sound, "-o", tmp_path / "b.mp4")
        assert not (tmp_path / "b.mp4").exists()
