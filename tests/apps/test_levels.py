"""Levels of detail on the command line: made, described, converted, turned, exported."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from apps import cli
from apps.avatar import detail
from glsplat.authoring.detail.measure import MeasureConfig
from glsplat.avatar import Avatar
from glsplat.formats import load, save
from glsplat.splats import Splats
from tests.apps.cli import ok, run
from tests.formats.scenes import avatar_with_levels, edit_glb, glb_parts, splats_with_levels
from tests.scenes import cloud


def test_inspect_lists_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(avatar_with_levels(), tmp_path / "a.glb")
    report = json.loads(ok(capsys, "inspect", tmp_path / "a.glb", "--json"))
    first, second, _ = report["levels"]
    assert [first[key] for key in ("splats", "density", "metres", "psnr")] == [20, 200.0, 2.56, 41.5]
    avatar = avatar_with_levels()
    content = avatar.levels[0].content
    size = content.splats.nbytes + content.skin.joints.nbytes + content.skin.weights.nbytes
    assert first["memory_bytes"] == size and second["psnr"] is None and report["cones_psnr"] == 45.5
    text = ok(capsys, "inspect", tmp_path / "a.glb")
    assert "levels       20 splats from 2.6 m on at 1024 px and 90 degrees (200 px/m), 41.5 dB at worst" in text
    assert "10 splats from 5.1 m on at 1024 px and 90 degrees (100 px/m), error unknown" in text
    assert "the worst picture keeps 45.5 dB without what they hide" in text


def test_inspect_says_which_are_broken(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    save(splats_with_levels(), tmp_path / "a.glb")
    edit_glb(tmp_path / "a.glb", lambda document: document["nodes"][2].pop("extras"))
    assert cli.main(["inspect", str(tmp_path / "a.glb")]) == 0
    assert f"{tmp_path / 'a.glb'}: level of detail 2 is left out: it has no density" in caplog.text
    assert cli.main(["inspect", str(tmp_path / "a.glb"), "--strict"]) == 1


def test_convert_keeps_them_and_turns_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, scene in (("a", avatar_with_levels()), ("s", splats_with_levels())):
        save(scene, tmp_path / f"{name}.glb")
        assert ok(capsys, "convert", tmp_path / f"{name}.glb", tmp_path / f"{name}2.glb", "--up", "z") == ""
        found = load(tmp_path / f"{name}2.glb", strict=True)
        assert type(found) is type(scene) and len(found.levels) == 3
        whole = found.splats if isinstance(found, Avatar) else found
        for one, other in zip(found.levels, scene.levels, strict=True):
            assert (one.density, one.psnr) == (other.density, other.psnr)
            splats = one.content.splats if isinstance(one.content, Avatar) else one.content
            np.testing.assert_allclose(splats.means, whole.means[: len(splats)], atol=1e-6)  # turned as the finest is
            np.testing.assert_allclose(splats.scales, whole.scales[: len(splats)], rtol=1e-6)


def test_export_poses_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(avatar_with_levels(), tmp_path / "a.glb")
    ok(capsys, "avatar", "export", tmp_path / "a.glb", "-o", tmp_path / "b.glb")
    found = load(tmp_path / "b.glb")
    assert isinstance(found, Splats) and [len(level.content) for level in found.levels] == [20, 10, 5]
    np.testing.assert_allclose(found.levels[0].content.means, found.means[:20], atol=1e-5)
    assert run("avatar", "export", tmp_path / "a.glb", "-o", tmp_path / "b.ply") == 0
    assert "3 coarser levels of detail dropped" in capsys.readouterr().err


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.usefixtures("gl")
def test_levels_are_added_to_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = partial(MeasureConfig, directions=2, inside=0, size=96)
    monkeypatch.setattr(detail, "MeasureConfig", quick)
    save(cloud(300, spread=0.2), tmp_path / "a.ply")
    command = ["avatar", "levels", tmp_path / "a.ply", "-o", tmp_path / "a.glb", "--psnr", "20"]
    facts = json.loads(ok(capsys, *command, "--counts", "150", "75", "--json"))
    found = load(tmp_path / "a.glb", strict=True)
    assert facts["splats"] == 300 and [one["splats"] for one in facts["levels"]] == [
        len(level.content) for level in found.levels if isinstance(level.content, Splats)
    ]
    assert found.levels and all(one["psnr"] >= 20 - MeasureConfig().slack for one in facts["levels"])
    first = (tmp_path / "a.glb").read_bytes()
    out = ok(capsys, *command, "--counts", "150", "75")
    assert (tmp_path / "a.glb").read_bytes() == first and "from" in out and "dB at worst" in out
    assert len(glb_parts(first)[0]["nodes"]) == 1 + len(found.levels)
