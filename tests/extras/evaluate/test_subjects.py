"""Scenes of a report: their cameras, how they move, how they get fewer splats, and what is right for a person."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glsplat.config import RenderConfig, with_fields
from glsplat.errors import FormatError
from glsplat.extras.evaluate.knobs import base_config, error_frames, settings_of
from glsplat.extras.evaluate.sections.measure import measure
from glsplat.extras.evaluate.subjects import Subject, cameras_for, check_cameras, subjects_of
from glsplat.formats import save
from glsplat.gl.context import Context
from tests.golden.stored import DATA
from tests.scenes import camera, cloud, limb

pytest.importorskip("flip_evaluator")


def test_scenes_and_their_cameras(tmp_path: Path) -> None:
    save(cloud(50), tmp_path / "a.ply")
    (plain,) = subjects_of(str(tmp_path / "a.ply"), 64)
    assert plain.name == "a.ply" and [v.width for v in plain.views(3)] == [64, 64]
    (tmp_path / "a.camera.json").write_text(json.dumps(camera(200).to_json()))
    (given,) = subjects_of(str(tmp_path / "a.ply"), 64)
    first, second, third = (given.views(frame)[0] for frame in range(3))
    assert (first.width, first.height) == (64, 64) and len(given.views(0)) == 1
    assert 0 < np.abs(first.viewmat - second.viewmat).max() < 1e-5  # moves enough to be sorted, not to be seen
    assert (first.viewmat == third.viewmat).all() and (first.viewmat == camera(200).viewmat).all()
    save(limb(50), tmp_path / "b.glb")
    still, moving = subjects_of(str(tmp_path / "b.glb"), 64)
    assert still.pose(4) is None and moving.pose(4) is not None


def test_cameras_that_lie_elsewhere(tmp_path: Path) -> None:
    folder = tmp_path / "cameras"
    folder.mkdir()
    scene, inside, other = tmp_path / "garden.ply", folder / "garden.camera.json", folder / "cam0.json"
    inside.write_text("{}")
    other.write_text("{}")
    assert cameras_for(scene, []) is None
    assert cameras_for(scene, [str(folder)]) == inside
    assert cameras_for(scene, [str(folder), f"garden={other}", f"tree={inside}"]) == other
    assert cameras_for(tmp_path / "tree.ply", [str(folder)]) is None
    scene.with_suffix(".camera.json").write_text("{}")
    assert cameras_for(scene, [str(folder)]) == scene.with_suffix(".camera.json")
    check_cameras([str(folder), f"garden={other}"], [str(scene)])
    for words, message in (
        ("nowhere", "--cameras takes a folder"),
        ("garden=nowhere.json", "no such camera file"),
        (f"gardn={other}", "no scene is called gardn"),
    ):
        with pytest.raises(FormatError, match=message):
            check_cameras([words], [str(scene)])


@pytest.mark.usefixtures("gl")
@pytest.mark.gl
def test_old_orders_are_compared_at_their_oldest(context: Context) -> None:
    """A re-sort period is shown all frames before those that count, and its error grows with its age."""
    subject = Subject("limb", limb(300, degree=1), 48, moving=True)
    frames = error_frames(subject, 12)
    assert frames == [7, 15] and error_frames(subject, 30) == [7, 23, 31]
    assert error_frames(subject, 12, few=True) == [15]
    given = Subject("given", cloud(10), 32, cameras=(camera(32),))
    assert error_frames(given, 30) == [34] and error_frames(given, 3) == [6]
    base = base_config(context)
    settings = settings_of(subject, base)
    assert {s.label for s in settings if s.knob == "re-sort period"} == {"1", "2", "4", "8"}
    assert "re-sort period" not in {s.knob for s in settings_of(given, base)}
    periods = [s for s in settings if s.knob in ("default", "re-sort period")]
    rows = measure(context, subject, periods, 8, [7])["settings"]
    psnr = {r["setting"]: r["psnr"] for r in rows if r["knob"] == "re-sort period"}
    assert psnr["1"] > 65 and psnr["1"] > psnr["2"] > psnr["4"] > psnr["8"]


@pytest.mark.usefixtures("gl")
@pytest.mark.gl
def test_exact_ties_stay_exact_under_a_given_camera(context: Context) -> None:
    """Far from the origin float32 leaves splats at equal depths: their order is that of the camera as it was given."""
    (subject,) = subjects_of(str(DATA / "huge_coords.ply"), 128)
    settings = settings_of(subject, with_fields(RenderConfig(), target="32f", shape="triangle"))[:2]
    result = measure(context, subject, settings, 3, error_frames(subject, 3))
    assert result["settings"][0]["psnr"] > 110
