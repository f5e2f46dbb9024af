"""Commands with scene files, meshes, another up axis, depth and alpha."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat import reference
from glsplat.camera import Camera, look_at, pinhole
from glsplat.data import default_avatar
from glsplat.formats import load_scene, save
from glsplat.formats.scene_file import upright
from glsplat.pictures import straight
from glsplat.renderer import Renderer
from tests.apps.cli import mistake, ok, run
from tests.compare import Difference
from tests.scene.worlds import reference_of
from tests.scenes import camera, cloud, eyes, limb
from tests.skinning.avatars import part

pytestmark = pytest.mark.gl

OBJ = "v -1 -1 -0.5\nv 1 -1 -0.5\nv 0 1 -0.5\nf 1 2 3\n"


@pytest.fixture
def world(tmp_path: Path) -> Path:
    """A cloud, two arms of which one is hidden, and a triangle behind them."""
    save(cloud(200, 2), tmp_path / "cloud.ply")
    save(limb(200), tmp_path / "limb.glb")
    (tmp_path / "wall.obj").write_text(OBJ)
    return written(
        tmp_path,
        {"path": "cloud.ply", "translation": [0.2, 0, 0], "rotation": [0, 0, 1, 1], "scale": 0.8},
        {"path": "limb.glb", "pose": {"joints": {limb(1).skeleton.names[1]: [0, 0, 0.5]}}},
        {"path": "limb.glb", "visible": False},
        {"path": "wall.obj"},
        background=[0.1, 0.2, 0.3],
    )


def written(folder: Path, *items: dict[str, Any], **more: Any) -> Path:
    (folder / "scene.json").write_text(json.dumps({"version": 1, "items": items, **more}))
    return folder / "scene.json"


def test_render_a_scene_file(world: Path, tmp_path: Path) -> None:
    views = [camera(48, background=(0.1, 0.2, 0.3))]
    (tmp_path / "camera.json").write_text(json.dumps(views[0].to_json()))
    out, depth = tmp_path / "out.npy", tmp_path / "depth.npy"
    run("render", world, "--cameras", tmp_path / "camera.json", "-o", out, "--depth", depth, "--float-target", "32f")
    images, depths = reference_of(load_scene(world).scene, views)
    assert Difference.of(np.load(out), images[0]).psnr > 65 and np.load(depth).shape == (48, 48)
    solid = images[0, ..., 3] > 0.05  # where little is seen, rounding decides what its depth is
    assert np.abs(np.load(depth) - depths[0])[solid].max() < 1e-3


def test_the_scene_file_says_the_background(world: Path, tmp_path: Path) -> None:
    away = ["--size", "32", "--eye", "0,0,30", "--target", "0,0,60", "-o", tmp_path / "a.png"]
    for more, colour in (([], [76, 51, 26]), (["--background", "1,0,0"], [0, 0, 255])):
        assert run("render", world, *away, *more) == 0
        assert cv2.imread(str(tmp_path / "a.png"))[0, 0].tolist() == colour


@pytest.mark.extra(name="consent")
@pytest.mark.extra(name="evaluate")
def test_bench_and_inspect(world: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = json.loads(ok(capsys, "bench", world, "--sizes", "32x32", "--frames", "3", "--json"))
    assert report["settings"][0]["kind"] == "static" and report["settings"][0]["splats"] == 400
    report = json.loads(ok(capsys, "inspect", world, "--json"))
    assert report["kind"] == "scene" and report["splats"] == 600 and report["background"] == [0.1, 0.2, 0.3]
    assert [entry["kind"] for entry in report["items"]] == ["splats", "avatar", "avatar", "mesh"]
    assert report["items"][0]["scale"] == pytest.approx(0.8) and report["items"][1]["posed"]
    assert not report["items"][2]["visible"] and report["items"][3]["triangles"] == 1
    text = ok(capsys, "inspect", world)
    assert "4 items, 600 splats" in text and "hidden" in text and "1 triangles" in text


@pytest.fixture
def walkers(tmp_path: Path) -> Callable[..., Path]:
    """Small people of the embedded rig, each with these entries of its own."""
    save(part(default_avatar(), np.arange(0, 40000, 400)), tmp_path / "body.glb")

    def write(*entries: dict[str, Any]) -> Path:
        places = [[0.8 * i, 0, 0] for i in range(len(entries))]
        items = [{"path": "body.glb", "translation": p, **e} for p, e in zip(places, entries, strict=True)]
        return written(tmp_path, *items)

    return write


def test_motions_play(walkers: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = walkers({"motion": "walk"}, {"motion": "idle"})
    view = ["--size", "40", "--eye", "0.4,1,4", "--target", "0.4,1,0"]
    run("render", file, *view, "--frame", "12", "--fps", "24", "-o", tmp_path / "a.npy")
    scene = load_scene(file)
    scene.pose_at(0.5)
    cam = Camera(look_at((0.4, 1, 4), (0.4, 1, 0)), pinhole(40, 40), 40, 40)
    with Renderer(scene.scene, size=(40, 40)) as renderer:
        expected = renderer.render([cam])[0] / 255
    assert np.abs(np.load(tmp_path / "a.npy") - expected).max() < 0.0021
    run("render", file, *view, "-o", tmp_path / "b.npy")  # one picture: the beginning
    assert np.abs(np.load(tmp_path / "b.npy") - np.load(tmp_path / "a.npy")).max() > 0.01
    run("render", file, *view, "--fps", "2", "-o", f"{tmp_path}/clip/")
    assert len(list((tmp_path / "clip").iterdir())) == round(scene.duration * 2)
    for option in (["--motion", "idle"], ["--pose", tmp_path / "no.json"]):
        assert "is for one avatar, this scene has several" in mistake(capsys, "render", file, *option, "-o", "x.png")
    assert "--frame needs 0 to" in mistake(capsys, "render", file, "--frame", "99999", "-o", "x.png")


def test_up_is_the_same_drawn_and_converted(tmp_path: Path) -> None:
    """Against the float64 twin of the unturned splats seen by a camera that is turned the other way."""
    up = "z"
    splats = cloud(300, 3)
    save(splats, tmp_path / "a.ply")
    run("convert", tmp_path / "a.ply", tmp_path / "b.ply", "--up", up)
    view = camera(48)
    (tmp_path / "camera.json").write_text(json.dumps(view.to_json()))
    more = ["--cameras", tmp_path / "camera.json", "--float-target", "32f"]
    run("render", tmp_path / "a.ply", "--up", up, *more, "-o", tmp_path / "a.npy")
    run("render", tmp_path / "b.ply", *more, "-o", tmp_path / "b.npy")
    written(tmp_path, {"path": "a.ply"}, up=up)
    run("render", tmp_path / "scene.json", *more, "-o", tmp_path / "c.npy")
    run("render", written(tmp_path, {"path": "a.ply"}), "--up", up, *more, "-o", tmp_path / "d.npy")
    turned = Camera(view.viewmat @ upright(up), view.K, 48, 48)
    expected = reference.render(splats, [turned])[0]
    for name in "abcd":
        assert Difference.of(np.load(tmp_path / f"{name}.npy"), expected).psnr > 65, name
    unturned = reference.render(splats, [view])[0]
    assert Difference.of(unturned, expected).psnr < 40  # it matters


def test_depth_and_alpha(world: Path, tmp_path: Path) -> None:
    views = list(eyes(48))
    (tmp_path / "camera.json").write_text(json.dumps([view.to_json() for view in views]))
    common = ["render", world, "--cameras", tmp_path / "camera.json", "--float-target", "32f"]
    run(*common, "-o", tmp_path / "a.png", "--alpha", "--depth", tmp_path / "mm.png")
    run(*common, "-o", tmp_path / "a.npy", "--depth", tmp_path / "m.npy")
    image = np.load(tmp_path / "a.npy").reshape(2, 48, 48, 4)
    picture = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)[..., [2, 1, 0, 3]]
    expected = np.rint(np.clip(straight(np.concatenate(list(image), axis=1)), 0, 1) * 255)
    assert picture.shape == (48, 96, 4) and (picture == expected).all()
    assert 0 < (picture[..., 3] == 0).mean() < 1 and len(np.unique(picture[..., 3])) > 10
    metres = np.load(tmp_path / "m.npy")
    assert metres.shape == (2, 48, 48) and metres.dtype == np.float32
    grey = cv2.imread(str(tmp_path / "mm.png"), cv2.IMREAD_UNCHANGED)
    wide = np.concatenate(list(metres), axis=1)
    assert grey.dtype == np.uint16 and np.abs(grey / 1000 - wide).max() < 6e-4 and ((grey == 0) == (wide == 0)).all()
