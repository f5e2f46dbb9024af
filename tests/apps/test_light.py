"""--light on the command line: presets, files, what a scene file says, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps.cli import main
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats import load, load_scene, save
from glsplat.formats.scene_file import upright
from glsplat.light.light import Light
from tests.apps.cli import mistake, ok
from tests.light.lit import random_light, surfaced
from tests.scenes import limb

pytestmark = pytest.mark.gl


@pytest.fixture
def avatar(tmp_path: Path) -> Path:
    save(surfaced(limb(80)), tmp_path / "me.glb")
    return tmp_path / "me.glb"


def picture(folder: Path, *arguments: object) -> np.ndarray:
    out = folder / "out.png"
    assert main(["render", *map(str, arguments), "-o", str(out), "--size", "48x48"]) == 0
    found = cv2.imread(str(out))
    assert found is not None
    return np.asarray(found).astype(int)


def test_a_preset_a_file_and_a_scene_file_light_alike(avatar: Path, tmp_path: Path) -> None:
    plain = picture(tmp_path, avatar)
    lit = picture(tmp_path, avatar, "--light", "evening")
    assert np.abs(lit - plain).max() > 10
    (tmp_path / "light.json").write_text(json.dumps(Light.preset("evening").to_json()))
    assert (picture(tmp_path, avatar, "--light", tmp_path / "light.json") == lit).all()
    scene = {"version": 1, "items": [{"path": "me.glb"}], "light": "evening"}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    assert (picture(tmp_path, tmp_path / "scene.json") == lit).all()
    assert (picture(tmp_path, tmp_path / "scene.json", "--light", "none") == plain).all()


@pytest.mark.extra(name="consent")
def test_inspect_says_what_light_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for shaded, said in ((True, "as photographed"), (False, "albedo"), (None, "never lit")):
        save(limb(20) if shaded is None else surfaced(limb(20), shaded=shaded), tmp_path / "a.glb")
        text = ok(capsys, "inspect", tmp_path / "a.glb")
        assert said in next(line for line in text.splitlines() if line.split()[0] == "light")


def test_what_is_no_light_is_one_line(avatar: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for light in ("noon", {"ambient": [[1, 2, 3]]}, 4, {"sun": {}}, [1]):
        (tmp_path / "scene.json").write_text(json.dumps({"version": 1, "items": [{"path": "me.glb"}], "light": light}))
        with pytest.raises(FormatError, match=r"scene\.json.*light"):
            load_scene(tmp_path / "scene.json")
    path = tmp_path / "light.json"
    for text, words in (("{", "JSON"), ('{"ambient": 3}', "ambient needs 9 x 3"), ("[" * 100_000, "JSON")):
        path.write_text(text)
        said = mistake(capsys, "render", avatar, "-o", tmp_path / "a.png", "--light", path)
        assert words in said and "light.json" in said and not (tmp_path / "a.png").exists()


def test_convert_turns_the_light_of_the_photograph(tmp_path: Path) -> None:
    light = random_light(3)
    person = surfaced(limb(40))
    save(replace(person, meta=dict(person.meta) | {"light": light.to_json()}), tmp_path / "lying.glb")
    assert main(["convert", str(tmp_path / "lying.glb"), str(tmp_path / "up.glb"), "--up", "z"]) == 0
    turned = load(tmp_path / "up.glb")
    assert isinstance(turned, Avatar)
    found = Light.from_json(turned.meta["light"])
    expected = light.turned(upright("z")[:3, :3])
    np.testing.assert_allclose(found.uniforms(), expected.uniforms(), atol=1e-6)
    assert not found.same(light)
