"""Scenes of a report: their cameras, how they move, how they get fewer splats, and what is right for a person."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.evaluate.subjects import cameras_for, check_cameras, subjects_of
from glsplat.formats import save
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
