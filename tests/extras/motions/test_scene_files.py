"""Scene files that name one of several animations of a file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from glsplat.data import default_avatar
from glsplat.formats import load_scene, save
from tests.extras.motions.clips import glb, turned
from tests.skinning.avatars import part


def test_one_animation_of_a_file(tmp_path: Path) -> None:
    save(part(default_avatar(), np.arange(50)), tmp_path / "body.glb")
    still = np.tile(turned("head", Rotation.identity()).as_quat(), (2, 1))
    channel = ("head", "rotation", "STEP", np.array([0.0, 2.0]), still)
    short = (*channel[:3], channel[3] / 2, channel[4])
    glb(tmp_path / "all.glb", [{"name": "Long", "channels": [channel]}, {"name": "Short", "channels": [short]}])
    items = [{"path": "body.glb", "motion": name} for name in ("all.glb", "all.glb#Short")]
    (tmp_path / "scene.json").write_text(json.dumps({"version": 1, "items": items}))
    assert [len(motion) for _, motion in load_scene(tmp_path / "scene.json").motions.values()] == [61, 31]
