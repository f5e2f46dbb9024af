"""The preview on scene files: which avatar the keys move, and what moves by itself."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from apps.preview.cameras import Options
from apps.preview.viewer import Viewer
from glsplat.data import default_avatar
from glsplat.formats import load_scene, save
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.formats.scene_file import SceneFile
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from tests.scenes import cloud
from tests.skinning.avatars import part

pytestmark = pytest.mark.gl


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., SceneFile]:
    save(part(default_avatar(), np.arange(0, 40000, 400)), tmp_path / "body.glb")
    save(cloud(50), tmp_path / "cloud.ply")

    def write(*items: dict[str, Any]) -> SceneFile:
        (tmp_path / "scene.json").write_text(json.dumps({"version": 1, "items": items}))
        return load_scene(tmp_path / "scene.json")

    return write


@pytest.fixture
def viewer_of(context: Context) -> Iterator[Callable[..., Viewer]]:
    view, made = Options(eye=(0.4, 1.0, 4.0), target=(0.4, 1.0, 0.0)), list[Viewer]()

    def make(scene: Any) -> Viewer:
        made.append(Viewer(scene, context, (64, 48), view, "scene"))
        return made[-1]

    with context.ctx:
        yield make
        for viewer in made:
            viewer.release()


def test_the_one_avatar_plays_what_the_file_says(
    viewer_of: Callable[..., Viewer], written: Callable[..., SceneFile], tmp_path: Path
) -> None:
    viewer = viewer_of(written({"path": "cloud.ply"}, {"path": "body.glb", "motion": "walk"}))
    assert viewer.player is not None and viewer.player.motion is not None and viewer.animating
    viewer.advance(0.5)
    expected = load_embedded_motion("walk", viewer.player.skeleton).at(0.5)
    assert np.allclose(viewer.pose().rotations, expected.rotations)  # type: ignore[union-attr]
    viewer.press("space")
    assert not viewer.animating
    posed = viewer_of(written({"path": "body.glb", "pose": {"root_pose": [0, 1, 0]}}))
    assert posed.pose().rotations[0].tolist() == [0, 1, 0] and not posed.animating  # type: ignore[union-attr]
    posed.drop(str(tmp_path / "scene.json"))
    assert posed.player is not None and "scene.json" in posed.overlay._message


def test_several_avatars_move_by_themselves(
    viewer_of: Callable[..., Viewer], written: Callable[..., SceneFile], context: Context
) -> None:
    bodies = [{"path": "body.glb", "motion": "walk"}, {"path": "body.glb", "translation": [0.8, 0, 0]}]
    viewer = viewer_of(written(*bodies))
    assert viewer.player is None and viewer.animating
    before = viewer.capture()
    viewer.advance(0.4)
    assert viewer.dirty
    after = viewer.capture()
    assert (before != after).any()
    still = written(*bodies)
    still.pose_at(0.4)
    with Renderer(still.scene, size=(64, 48), context=context) as renderer:
        assert np.abs(renderer.render(viewer.cameras())[0, ..., :3].astype(int) - after).max() <= 1
    viewer.press("space")
    viewer.dirty = False
    viewer.advance(0.4)
    assert not viewer.animating and not viewer.dirty
