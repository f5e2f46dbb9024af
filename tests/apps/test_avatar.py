"""``glsplat avatar``: make, import, export, motions; and the avatar that comes with the package."""

import json
from pathlib import Path

import numpy as np
import pytest

import apps.cli as cli
from apps.avatar.making import counts_of
from glsplat.authoring.cones import ConeConfig
from glsplat.authoring.detail.fitted import FittedConfig
from glsplat.authoring.detail.measure import MeasureConfig
from glsplat.authoring.optimize.pictures import ViewConfig
from glsplat.avatar import Avatar
from glsplat.data import DEFAULT, embedded_file
from glsplat.formats import FORMATS, load, save
from tests.formats.scenes import random_avatar

DATA = Path(cli.__file__).parents[1] / "glsplat" / "data"


def test_default_avatar_file():
    path = embedded_file(DEFAULT)
    avatar = load(path)
    assert path.stat().st_size <= 8e6 and isinstance(avatar, Avatar) and 39_000 <= len(avatar.splats) <= 41_000
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


@pytest.mark.check
@pytest.mark.usefixtures("quickly_made")
def test_make_import_export(person, tmp_path, monkeypatch, capsys):
    for name, value in {"size": 48, "test_size": 64, "tests": 2, "choosing": 2}.items():
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

    zero, bound = tmp_path / "zero.ply", tmp_path / "bound.glb"
    assert cli.main(["avatar", "export", str(out), "-o", str(zero)]) == 0
    assert cli.main(["avatar", "import", str(zero), "--mesh", str(person), "-o", str(bound)]) == 0
    coned, words = tmp_path / "coned.glb", ["--directions", "8"]
    assert avatar.splats.cones is None and avatar.splats.antialias
    assert cli.main(["avatar", "cones", str(out), "-o", str(coned), *words]) == 0
    again = load(coned)
    assert again.splats.cones.shape == (200, 4) and np.array_equal(again.splats.means, avatar.splats.means)

    assert load(bound).skin.dense(2) == pytest.approx(avatar.skin.dense(2), abs=0.1)


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.usefixtures("quickly_made")
def test_levels_are_made_with_the_avatar(person, tmp_path, monkeypatch, capsys):
    for name, value in {"size": 200, "poses": 1}.items():
        monkeypatch.setitem(FittedConfig.__init__.__kwdefaults__, name, value)
    monkeypatch.setitem(MeasureConfig.__init__.__kwdefaults__, "psnr", 20.0)  # what boxes of so few splats keep
    out = tmp_path / "a.glb"
    words = ["avatar", "make", str(person), "-o", str(out), "--splats", "400", "--steps", "0", "--no-cones"]
    assert cli.main([*words, "--levels", "200"]) == 0
    (level,) = load(out).levels
    assert len(level.content.splats) == 200 and level.density > 0 and level.psnr >= 20 - MeasureConfig().slack
    capsys.readouterr()
    assert counts_of(None, 40_000) == (20_000, 10_000, 5_000) and counts_of(None, 9_999) == ()
    assert counts_of(["none"], 40_000) == counts_of(["0"], 40_000) == ()
    assert cli.main(["avatar", "motions", "-o", str(tmp_path)]) == 0
    assert (tmp_path / "walk.json").read_bytes() == (DATA / "walk.json").read_bytes()


@pytest.mark.parametrize("suffix", [known.suffixes[0] for known in FORMATS if known.save])
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
