"""``glsplat avatar``: make, import, export, motions; and the avatar that comes with the package."""

import json
from pathlib import Path

import numpy as np
import pytest

import apps.cli as cli
from apps.avatar.making import counts_of
from glsplat.extras.authoring.finish.cones import ConeConfig
from glsplat.extras.authoring.finish.level_measure import MeasureConfig
from glsplat.extras.authoring.finish.levels import FittedConfig
from glsplat.extras.authoring.optimize.target_pictures import ViewConfig
from glsplat.formats import all_formats, load, save
from tests.formats.scenes import random_avatar
from tests.scene.people import boxes, save_person

DATA = Path(cli.__file__).parents[1] / "glsplat" / "data"


@pytest.fixture(scope="module")
def person(tmp_path_factory) -> Path:
    """A mesh of boxes on the joints of SMPL-X."""
    return save_person(boxes(), tmp_path_factory.mktemp("person") / "box.npz")


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

    (tmp_path / "pose.json").write_text('{"joints": {"left_shoulder": [0, 0, 1.0]}, "trans": [0, 0, 0.5]}')
    ply = tmp_path / "posed.ply"
    assert cli.main(["avatar", "export", str(out), "--pose", str(tmp_path / "pose.json"), "-o", str(ply)]) == 0
    assert load(ply).means[:, 2].mean() == pytest.approx(avatar.splats.means[:, 2].mean() + 0.5, abs=0.02)

    (tmp_path / "long.json").write_text('{"translations": {"head": [0, 0.3, 0]}}')  # single poses may stretch
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

    off = np.abs(load(bound).skin.dense(55) - avatar.skin.dense(55)).max(axis=1)
    assert np.mean(off < 0.1) > 0.6  # boxes of neighbouring joints overlap


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


@pytest.mark.parametrize("suffix", [known.suffixes[0] for known in all_formats().values() if known.save])
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
        if (
            len(written) == len(avatar.splats)
            and next(k for k in all_formats().values() if suffix in k.suffixes).order is None
        ):
            np.testing.assert_allclose(written.means, np.stack(expected, axis=1), atol=2e-3)
        back = tmp_path / "back.glb"
        assert cli.main(["convert", str(path), str(back), f"--up={up}"]) == 0
        assert np.abs(load(back).means.mean(axis=0) - upright.mean(axis=0)).max() < 2e-3
