"""``glsplat avatar``: make, import, export, motions; and the avatar that comes with the package."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import apps.cli as cli
from apps.avatar.making import counts_of
from glsplat.authoring.cones import ConeConfig
from glsplat.authoring.detail.fitted import FittedConfig
from glsplat.authoring.detail.measure import MeasureConfig
from glsplat.authoring.optimize.pictures import ViewConfig
from glsplat.authoring.surface import SamplerConfig
from glsplat.avatar import Avatar
from glsplat.data import DEFAULT, default_avatar, embedded_file
from glsplat.formats import FORMATS, load, save
from tests.formats.scenes import random_avatar

DATA = Path(cli.__file__).parents[1] / "glsplat" / "data"


def test_default_avatar_file():
    path = embedded_file(DEFAULT)
    assert path.stat().st_size <= 8e6
    avatar = load(path)
    # loading it is 1.2 times a loop over its splats here
    assert least_time(lambda: load(path)) < 6 * least_time(lambda: [tuple(row) for row in avatar.splats.means])
    assert isinstance(avatar, Avatar) and 39_000 <= len(avatar.splats) <= 41_000
    assert avatar.splats.sh_degree == 0 and avatar.skin.influences == 4
    assert avatar.splats.finite().all() and avatar.splats.scales.min() > 0
    assert {"version", "source", "licence", "consent", "body_model"} <= set(avatar.meta)
    low, high = np.percentile(avatar.splats.means, (0.1, 99.9), axis=0)
    assert low[1] == pytest.approx(0, abs=0.02) and 1.6 < high[1] < 2.0
    assert avatar.skeleton.joints[avatar.skeleton.names.index("left_wrist"), 0] > 0.5
    strongest = avatar.skin.joints[:, 0]
    for side, wrist in (("left", 20), ("right", 21)):
        fingers = [i for i, name in enumerate(avatar.skeleton.names) if name.startswith(f"{side}_") and i >= 25]
        assert np.isin(strongest, [wrist, *fingers]).sum() >= 3500
    licence = (DATA / "LICENSE-default-avatar.md").read_text()
    assert "CC0" in licence and "MakeHuman system assets, CC0 since 2020-09" in " ".join(licence.split())


def least_time(call: Callable[[], object]) -> float:
    times = []
    for _ in range(3):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return min(times)


@pytest.fixture(scope="module")
def person(tmp_path_factory) -> Path:
    """A striped box with two joints."""
    import cv2
    import trimesh

    box = trimesh.creation.box((0.4, 1.0, 0.2)).subdivide().subdivide()
    points, faces = np.asarray(box.vertices) + (0, 0.5, 0), np.asarray(box.faces)
    texture = np.zeros((16, 16, 3), np.uint8)
    texture[::2] = (60, 180, 240)
    path = tmp_path_factory.mktemp("person") / "box.npz"
    np.savez(
        path,
        vertices=points.astype(np.float32),
        joints=np.array([[0, 0, 0], [0, 0.5, 0]], np.float32),
        parents=np.array([-1, 0]),
        joint_names=np.array(["low", "high"]),
        skin_indices=np.tile([0, 1], (len(points), 1)).astype(np.uint8),
        skin_weights=np.stack([1 - points[:, 1], points[:, 1]], 1).astype(np.float32),
        part_names=np.array(["box"]),
        faces_0=faces.astype(np.uint16),
        faces_uv_0=faces.astype(np.uint16),
        uv_0=points[:, :2].astype(np.float32) + (0.2, 0),
        texture_0=cv2.imencode(".png", texture)[1].reshape(-1),
    )
    return path


def test_make_import_export(person, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(SamplerConfig.__init__.__kwdefaults__, "probe", 96)  # a box is seen as well by fewer rays
    for name, value in {"size": 48, "test_size": 64, "tests": 3, "choosing": 3}.items():
        monkeypatch.setitem(ConeConfig.__init__.__kwdefaults__, name, value)
    for name, value in {"body": 3, "poses": 1, "size": 96}.items():
        monkeypatch.setitem(ViewConfig.__init__.__kwdefaults__, name, value)
    out = tmp_path / "a.glb"
    words = ["avatar", "make", str(person), "-o", str(out), "--splats", "200", "--steps", "2", "--json", "--no-cones"]
    assert cli.main([*words, "--licence", "CC0-1.0"]) == 0
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert facts["splats"] == 200 and facts["bytes"] == out.stat().st_size
    avatar = load(out)
    assert avatar.meta["licence"] == "CC0-1.0" and avatar.meta["source"] == "box.npz"

    (tmp_path / "pose.json").write_text('{"joints": {"high": [0, 0, 1.0]}, "trans": [0, 0, 0.5]}')
    ply = tmp_path / "posed.ply"
    assert cli.main(["avatar", "export", str(out), "--pose", str(tmp_path / "pose.json"), "-o", str(ply)]) == 0
    assert load(ply).means[:, 2].mean() == pytest.approx(0.5, abs=0.02)

    (tmp_path / "long.json").write_text('{"translations": {"high": [0, 0.3, 0]}}')  # single poses may stretch
    assert cli.main(["avatar", "export", str(out), "--pose", str(tmp_path / "long.json"), "-o", str(ply)]) == 0
    assert load(ply).means[:, 1].max() == pytest.approx(avatar.splats.means[:, 1].max() + 0.3, abs=0.02)
    assert "surface" in capsys.readouterr().err  # which .ply cannot hold
    (tmp_path / "degrees.json").write_text('{"joints": {"high": [0, 0, 90]}}')
    assert cli.main(["avatar", "export", str(out), "--pose", str(tmp_path / "degrees.json"), "-o", str(ply)]) == 1
    error = capsys.readouterr().err.strip()
    assert "degrees.json: high turns by 90 rad; angles are radians" in error and "\n" not in error

    zero, bound = tmp_path / "zero.ply", tmp_path / "bound.glb"
    assert cli.main(["avatar", "export", str(out), "-o", str(zero)]) == 0
    assert cli.main(["avatar", "import", str(zero), "--mesh", str(person), "-o", str(bound)]) == 0
    coned, words = tmp_path / "coned.glb", ["--directions", "8"]
    assert avatar.splats.cones is None and avatar.splats.antialias
    assert cli.main(["avatar", "cones", str(out), "-o", str(coned), *words]) == 0
    again = load(coned)
    assert again.splats.cones.shape == (200, 4) and np.array_equal(again.splats.means, avatar.splats.means)

    assert load(bound).skin.dense(2) == pytest.approx(avatar.skin.dense(2), abs=0.1)


@pytest.mark.gl
def test_levels_are_made_with_the_avatar(person, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(SamplerConfig.__init__.__kwdefaults__, "probe", 96)
    for name, value in {"steps": 6, "size": 200, "poses": 1}.items():
        monkeypatch.setitem(FittedConfig.__init__.__kwdefaults__, name, value)
    monkeypatch.setitem(MeasureConfig.__init__.__kwdefaults__, "psnr", 20.0)  # what boxes of so few splats keep
    out = tmp_path / "a.glb"
    words = ["avatar", "make", str(person), "-o", str(out), "--splats", "400", "--steps", "0", "--no-cones"]
    assert cli.main([*words, "--levels", "200"]) == 0
    (level,) = load(out).levels
    assert len(level.content.splats) == 200 and level.density > 0 and level.psnr >= 20 - MeasureConfig().slack
    capsys.readouterr()
    assert cli.main([*words, "--levels", "none"]) == 0
    assert load(out).levels == ()


def test_the_default_levels_are_halves():
    assert counts_of(None, 40_000) == (20_000, 10_000, 5_000) and counts_of(None, 9_999) == ()
    assert counts_of(["none"], 40_000) == counts_of(["0"], 40_000) == ()


def test_motions(tmp_path, capsys):
    assert cli.main(["avatar", "motions", "-o", str(tmp_path)]) == 0
    for name in ("idle", "walk", "wave-and-turn"):
        assert (tmp_path / f"{name}.json").read_bytes() == (DATA / f"{name}.json").read_bytes()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["make", "absent.npz", "-o", "a.glb"], "absent.npz: cannot read"),
        (["make", "{person}", "-o", "a.ply"], "written as .glb"),
        (["make", "{person}", "-o", "a.glb", "--steps", "-1"], "--steps"),
        (["make", "{person}", "-o", "a.glb", "--splats", "3"], "at least 100"),
        (
            ["make", "{person}", "-o", "a.glb", "--levels", "40000"],
            "--levels needs falling numbers of splats below 40000",
        ),
        (["make", "{person}", "-o", "a.glb", "--levels", "200", "300"], "not 200 300"),
        (["make", "{person}", "-o", "a.glb", "--levels", "99"], "none under 100"),
        (["make", "{person}", "-o", "a.glb", "--levels", "few"], "not few"),
        (["cones", "{avatar}", "-o", "a.ply"], "written as .glb"),
        (["cones", "{avatar}", "-o", "a.glb", "--psnr", "0"], "--psnr"),
        (["cones", "{avatar}", "-o", "a.glb", "--directions", "7"], "--directions"),
        (["cones", "absent.glb", "-o", "a.glb"], "absent.glb"),
        (["import", "{person}", "-o", "a.glb"], "an LHM dump needs query_points"),
        (["import", "{person}", "--mesh", "{person}", "-o", "a.glb"], "box.npz"),
        (["import", "absent.zip", "-o", "a.glb"], "absent.zip: cannot read"),
        (["import", "{person}", "--follow", "head", "-o", "a.glb"], "--follow is for LAM zips"),
        (["import", "absent.zip", "--mesh", "{person}", "-o", "a.glb"], "leave out --mesh"),
        (["score", "--mesh", "absent.npz"], "absent.npz: cannot read"),
        (["score", "{person}", "--mesh", "{person}"], "box.npz"),
        (["score", "--mesh", "{person}", "--views", "1"], "score against the mesh it was made from"),
        (["score", "--mesh", "{person}", "--poses", "9"], "--poses needs 1 to 8"),
        (["score", "--mesh", "{person}", "--views", "0"], "--views"),
        (["score", "--mesh", "{person}", "--size", "9"], "--size"),
        (["score", "--mesh", "{person}", "--grey", "nan"], "--grey"),
        (["score", "--mesh", "{person}", "--sheet", "a.gif"], "written as .png or .jpg"),
        (["export", "{person}", "-o", "a.ply"], "box.npz"),
        (["export", "{avatar}", "--pose", "nonsense", "-o", "a.ply"], "nonsense: no such file"),
        (["export", "{avatar}", "--pose", "idle", "--at", "nan", "-o", "a.ply"], "--at"),
    ],
)
def test_mistakes_are_one_line(person, tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    places = {"{person}": str(person), "{avatar}": str(embedded_file(DEFAULT))}
    code = cli.main(["avatar", *(places.get(word, word) for word in words)])
    error = capsys.readouterr().err
    assert code == (2 if error.endswith("--help\n") else 1)
    assert message in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_export_of_the_embedded_avatar(tmp_path, capsys):
    assert cli.main(["avatar", "export", "--pose", "walk", "-o", str(tmp_path / "a.ply")]) == 0
    assert len(load(tmp_path / "a.ply")) == len(default_avatar().splats)


@pytest.mark.parametrize("suffix", [suffix for known in FORMATS if known.save for suffix in known.suffixes])
def test_export_stands_upright_in_every_format(tmp_path, capsys, suffix):
    avatar = random_avatar(degree=1)
    save(avatar, tmp_path / "me.glb")
    (tmp_path / "pose.json").write_text('{"joints": {"bone 1": [0, 0, 0.4]}, "trans": [0.1, 0.2, 0.3]}')
    words = ["avatar", "export", str(tmp_path / "me.glb"), "--pose", str(tmp_path / "pose.json"), "-o"]
    assert cli.main([*words, str(tmp_path / "y.glb")]) == 0
    upright = load(tmp_path / "y.glb").means
    # by hand: the old x y z, y up, where the written file has z, -z or -y up
    x, y, z = upright.T
    for up, expected in {"z": (x, -z, y), "-z": (x, z, -y), "-y": (x, -y, -z)}.items():
        path = tmp_path / "out" / suffix if suffix == "meta.json" else tmp_path / f"out{suffix}"
        assert cli.main([*words, str(path), f"--up={up}", "--quiet"]) == 0
        assert capsys.readouterr().err == ""
        written = load(path)
        if len(written) == len(avatar.splats) and next(k for k in FORMATS if suffix in k.suffixes).order is None:
            np.testing.assert_allclose(written.means, np.stack(expected, axis=1), atol=2e-3)
        back = tmp_path / "back.glb"
        assert cli.main(["convert", str(path), str(back), f"--up={up}"]) == 0
        assert np.abs(load(back).means.mean(axis=0) - upright.mean(axis=0)).max() < 2e-3
