"""The preview: a viewer on a framebuffer, then the real window under Xvfb."""
# ruff: noqa: F811  (a fixture of another file has the name of its argument)

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps.output import side_by_side
from apps.preview.cameras import Options
from apps.preview.viewer import Viewer
from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.formats import save
from glsplat.gl.context import Context
from glsplat.net.served_scene import gl_server
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from tests.browser.served import Served
from tests.scenes import cloud, limb
from tests.xvfb import ROOT, display, psnr, python  # noqa: F401  (a fixture)

pytestmark = pytest.mark.gl
VIEW = Options(eye=(0.4, 0.3, 3.0), target=(0.7, 0.0, 0.0), background=(0.1, 0.2, 0.3))


@pytest.fixture
def viewer_of(context: Context) -> Iterator[Callable[..., Viewer]]:
    made: list[Viewer] = []

    def make(scene: Splats | Avatar, size: tuple[int, int] = (96, 64), options: Options = VIEW) -> Viewer:
        made.append(Viewer(scene, context, size, options, "scene"))
        return made[-1]

    with context.ctx:
        yield make
        for viewer in made:
            viewer.release()
        assert context.ctx.error == "GL_NO_ERROR"


@pytest.fixture
def headless(context: Context) -> Callable[..., np.ndarray]:
    def render(scene: Splats | Avatar, cameras: list[Camera], pose: Pose | None = None) -> np.ndarray:
        with Renderer(scene, size=(cameras[0].width, cameras[0].height), context=context) as renderer:
            return renderer.render(cameras, pose)[..., :3]

    return render


def test_layouts_show_what_render_renders(
    viewer_of: Callable[..., Viewer], headless: Callable[..., np.ndarray]
) -> None:
    avatar = limb(degree=1)
    viewer = viewer_of(avatar, (97, 64), replace(VIEW, ipd=0.5))
    assert viewer.player is not None
    viewer.player.select(1)
    viewer.player.turn((0, 0, 1), 40)
    views = {}
    for key, columns in (("1", 97), ("2", 96), ("3", 97)):
        viewer.press(key)
        shown = viewer.capture()
        expected = headless(avatar, viewer.cameras(), viewer.pose())
        views[key] = shown
        if key == "3":
            expected = np.concatenate([expected[0, ..., :1], expected[1, ..., 1:]], axis=-1)[None]
        error = np.abs(shown[:, :columns].astype(int) - side_by_side(expected))
        assert error.max() <= 1, key  # one driver: only the rounding to 8 bit may differ
        assert not shown[:, columns:].any()  # the odd column beside two eyes
    assert (views["1"] != views["3"]).mean() > 0.01 and views["2"][:, :48].any()


def test_keys_and_mouse(viewer_of: Callable[..., Viewer]) -> None:
    viewer = viewer_of(limb())
    first = viewer.capture()
    viewer.dirty = False
    viewer.press("nonsense")
    viewer.dirty = False
    viewer.move(30, 20)  # no button is down
    assert not viewer.dirty

    viewer.drag("left")
    viewer.move(40, 24)
    viewer.drag("")
    assert viewer.dirty and viewer.view.yaw != viewer._home.yaw and (viewer.capture() != first).any()
    viewer.press("R")
    assert np.array_equal(viewer.capture(), first)
    for button, shift in (("right", False), ("middle", False), ("left", True)):
        target = viewer.view.target
        viewer.drag(button, shift)
        viewer.move(viewer._cursor[0] + 5, 20)
        viewer.drag("")
        assert not np.allclose(viewer.view.target, target), button
    viewer.press("R")

    viewer.press("W")
    assert viewer.animating
    viewer.advance(100.0)  # a long pause is not a long flight
    assert 0 < np.linalg.norm(viewer.view.eye - viewer._home.eye) < 0.5
    viewer.unfocus()
    assert not viewer.animating
    viewer.press("R")

    viewer.press("left")  # the first joint is selected by itself
    assert viewer.player is not None and viewer.player.joint_name == "joint0" and viewer.player.turned == 5
    viewer.press("]")
    viewer.press("]", repeated=True)
    viewer.press("[")
    assert viewer.player.joint_name == "joint1"
    viewer.press("page up")
    assert (viewer.capture() != first).any()
    viewer.press("backspace")
    viewer.press("[")
    viewer.press("backspace")
    assert np.array_equal(viewer.capture(), first)
    viewer.press("M")  # another rig: a message, nothing else
    assert "no skeleton that the embedded" in viewer.overlay.lines(list)[-1][0]
    viewer.press("1", repeated=True)
    viewer.press("escape")
    assert viewer.closing


def test_overlays_are_drawn_over_the_picture(viewer_of: Callable[..., Viewer]) -> None:
    viewer = viewer_of(limb(), (400, 300))
    plain = viewer.capture()
    viewer.press("O")
    viewer.view = viewer.view.orbited(1e-3, 0)  # sorted again, so that every stage has a time
    numbers = viewer.capture()
    viewer.press("R")
    lines = [line[0] for line in viewer._text]
    assert {"pose", "sort", "project", "draw", "present"} <= set(lines) and "600 splats, 600 drawn" in lines
    changed = (numbers != plain).any(axis=-1)
    assert changed[10:150, 10:60].mean() > 0.5 and not changed[280:].any()
    viewer.press("H")
    assert (viewer.capture() != numbers).any()
    viewer.press("O")
    viewer.press("H")
    assert np.array_equal(viewer.capture(), plain)


def test_drop(viewer_of: Callable[..., Viewer], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    viewer = viewer_of(limb())
    before = viewer.capture()
    (tmp_path / "bad.ply").write_text("ply\nnonsense")
    viewer.drop(str(tmp_path / "bad.ply"))
    message = capsys.readouterr().err
    assert message.startswith("glsplat preview: ") and "bad.ply" in message and message.count("\n") == 1
    assert np.array_equal(viewer.capture(), before)
    poses = [{"joints": {"joint1": [0, 0, a]}} for a in (0.3, 0.6)]
    (tmp_path / "motion.json").write_text(json.dumps({"fps": 10, "frames": poses}))
    viewer.drop(str(tmp_path / "motion.json"))
    assert viewer.player is not None and viewer.player.moving and viewer.animating
    viewer.press("space")
    assert not viewer.animating and (viewer.capture() != before).any()
    save(limb(joints=6), tmp_path / "longer.glb")
    viewer.drop(str(tmp_path / "longer.glb"))
    assert viewer.player is not None and len(viewer.player.skeleton) == 6 and viewer.player.motion is None
    save(cloud(), tmp_path / "cloud.ply")
    viewer.drop(str(tmp_path / "cloud.ply"))
    assert viewer.player is None and viewer.capture().any()
    viewer.drop(str(tmp_path / "motion.json"))
    assert "no skeleton" in capsys.readouterr().err


def test_screenshot_key(viewer_of: Callable[..., Viewer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    viewer = viewer_of(cloud())
    viewer.press("P")
    viewer.press("P")
    files = sorted(tmp_path.iterdir())
    assert len(files) == 2
    for file in files:  # the message about the first is not in the second
        assert np.array_equal(cv2.imread(str(file))[..., ::-1], viewer.capture())
    monkeypatch.chdir("/proc")
    viewer.press("P")
    assert "cannot be written" in viewer.overlay.lines(list)[-1][0]


# --------------------------------------------------------------------------------------------------- under Xvfb


@pytest.mark.check
@pytest.mark.parametrize("connected", [False, True])
def test_command_saves_what_render_renders(
    display: str, tmp_path: Path, context: Context, headless: Callable[..., np.ndarray], connected: bool
) -> None:
    avatar = limb(degree=1)
    save(avatar, tmp_path / "limb.glb")
    frames = [{"joints": {"joint1": [0, 0, a], "joint2": [0, a, 0]}} for a in (0.0, 0.3, 0.6, 0.9)]
    (tmp_path / "motion.json").write_text(json.dumps({"fps": 30, "frames": frames}))
    command = ["-m", "apps.cli", "preview", "limb.glb", "--motion", "motion.json", "--frames", "3", "--json"]
    command += ["--screenshot", "shot.png", "--size", "200x150", "--eye=0.4,0.3,3", "--target=0.7,0,0"]
    with Served(make=lambda config: gl_server(avatar, config)) as served:
        more = ["--connect", served.server.url, "--quality", "95"] if connected else ["--background=0.1,0.2,0.3"]
        done = python(*command, *more, display=display, cwd=tmp_path)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    report = json.loads(done.stdout)
    assert report["window"] == [200, 150] and (report["shown"] == 3 if connected else report["splats"] == 600)
    shot = cv2.imread(str(tmp_path / "shot.png"))[..., ::-1]
    with context.ctx:
        view = replace(VIEW, background=(0.0, 0.0, 0.0)) if connected else VIEW
        viewer = Viewer(avatar, context, (200, 150), view)
        pose = Pose.from_json(frames[2], avatar.skeleton)
        expected = headless(avatar, viewer.cameras(), pose)[0]
        rest = headless(avatar, viewer.cameras())[0]
        viewer.release()
    assert psnr(shot, expected) >= (32 if connected else 45) and psnr(shot, rest) < 25


@pytest.mark.check
def test_window_session(display: str, tmp_path: Path) -> None:
    save(limb(degree=1), tmp_path / "limb.glb")
    done = python(
        "-m", "tests.apps.preview.preview_session", str(tmp_path / "limb.glb"), str(tmp_path), display=display
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["screen is capture"] == [True] * 3
    assert found["zoom"] == pytest.approx(0.81) and found["reset"]
    assert found["sizes"] == [[1, 1], [201, 151], [200, 150]]
    assert found["after resizing"] and set(found["gl errors"]) == {"GL_NO_ERROR"}
    assert found["draws"] <= 1 and 1 <= found["turns"] <= 6  # it sleeps: 40 turns where it looked each frame
