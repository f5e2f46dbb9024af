"""The embedded people: who they are, what they have, and that commands take their names."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps.args import load_avatar
from apps.cli import main
from glsplat.camera import Camera, look_at, pinhole
from glsplat.data import DEFAULT, PEOPLE, default_avatar, embedded_file, person
from glsplat.errors import FormatError, GlsplatError
from glsplat.light.light import Light
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES


@pytest.mark.parametrize("name", PEOPLE)
def test_each_has_a_small_file_a_face_and_a_licence(name: str) -> None:
    avatar = person(name)
    assert embedded_file(name).stat().st_size <= 6_000_000
    assert avatar.skeleton.names == JOINT_NAMES and len(avatar.splats) == 40_000
    assert avatar.shapes is not None and sorted(avatar.shapes.names) == sorted(ARKIT)
    assert set(np.unique(avatar.shapes.targets)) == set(range(52))
    assert all(level.content.shapes is not None for level in avatar.levels)
    assert "CC0" in avatar.meta["licence"] and "MIT" in avatar.meta["licence"]
    assert "MIT License" in (resources.files("glsplat.data") / "LICENSE-ict-facekit.txt").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", PEOPLE)
def test_lids_close_the_mouth_opens_and_eyes_turn_about_their_middles(name: str) -> None:
    avatar = person(name)
    shapes = avatar.shapes
    assert shapes is not None
    metres, targets = shapes.metres, shapes.targets
    for shape, least in (("eyeBlinkLeft", 0.006), ("eyeBlinkRight", 0.006), ("jawOpen", 0.02)):
        mine = metres[targets == shapes.names.index(shape)]
        assert -mine[:, 1].min() > least
    left, right = (avatar.skeleton.names.index(f"{side}_eye_smplhf") for side in ("left", "right"))
    for joint in (left, right):
        strongest = np.take_along_axis(avatar.skin.joints, avatar.skin.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
        ball = avatar.splats.means[strongest == joint] - avatar.skeleton.joints[joint]
        distance = np.linalg.norm(ball, axis=1)
        assert len(ball) > 300 and np.quantile(distance, 0.95) - np.quantile(distance, 0.05) < 0.0025


Look = Callable[[str, float, int, float, dict[str, float]], Callable[..., np.ndarray]]


@pytest.fixture
def look(renderer_of: Callable[..., Renderer]) -> Look:
    """Look at somebody's eyes from in front: metres away, pixels, degrees, expression -> what a box about an eye shows.

    A box is (side, left, right, low, high): metres from the middle of that eye, [N, 3] of 255.
    """

    def seen(name: str, away: float, side: int, fov: float, expression: dict[str, float]) -> Callable[..., np.ndarray]:
        avatar = person(name)
        names, joints = avatar.skeleton.names, avatar.skeleton.joints
        eyes = {side: joints[names.index(f"{side}_eye_smplhf")] + (0, 0, 0.012) for side in ("left", "right")}
        middle = (eyes["left"] + eyes["right"]) / 2
        view = Camera(look_at(middle + (0, 0, away), middle), pinhole(side, side, fov), side, side)
        pose = Pose(np.zeros((len(names), 3)), expression=expression)
        image = renderer_of(avatar, (side, side), level="auto").render([view], pose)[0][..., :3].astype(float)

        def box(eye: str, left: float, right: float, low: float, high: float) -> np.ndarray:
            corners = [eyes[eye] + (left, high, 0), eyes[eye] + (right, low, 0)]
            at = [view.K @ (view.viewmat @ np.append(one, 1))[:3] for one in corners]
            (x0, y0), (x1, y1) = ((one[:2] / one[2]).round().astype(int) for one in at)
            return image[y0:y1, x0:x1].reshape(-1, 3)

        return box

    return seen


@pytest.mark.gl
@pytest.mark.parametrize("name", PEOPLE)
def test_eyes_close_with_skin(look: Look, name: str) -> None:
    box = look(name, 0.8, 512, 18.0, {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0})
    for eye in ("left", "right"):
        cheek = np.median(box(eye, -0.01, 0.01, -0.04, -0.03), axis=0)
        lid = box(eye, -0.008, 0.008, -0.003, 0.006)
        assert (lid.mean(axis=0) > 0.8 * cheek).all() and (lid.mean(axis=0) < 1.1 * cheek).all()
        assert np.quantile(lid.mean(axis=1), 0.02) > 0.68 * cheek.mean()  # no pupil shows through


@pytest.mark.gl
@pytest.mark.parametrize("name", PEOPLE)
@pytest.mark.parametrize("way", [(0, 1, 0), (0, -1, 0), (0, 1, 0.7), (0, -1, -0.7)])
def test_nothing_shows_through_an_arm(
    renderer_of: Callable[..., Renderer], name: str, way: tuple[float, float, float]
) -> None:
    """From above and below, where a fit of stretched arms looks from last."""
    avatar = person(name)
    renderer = renderer_of(avatar, (256, 256))
    for side in ("left", "right"):
        elbow = avatar.skeleton.joints[avatar.skeleton.names.index(f"{side}_elbow")]
        eye = elbow + np.array(way) / np.linalg.norm(way)
        view = Camera(look_at(eye, elbow, up=(1, 0, 0)), pinhole(256, 256, 12), 256, 256)
        alpha = renderer.render([view])[0][..., 3]
        whole = cv2.morphologyEx((alpha > 0.5).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((25, 25), np.uint8))
        inside = cv2.erode(whole, np.ones((17, 17), np.uint8)).astype(bool)
        assert inside.sum() > 5000 and alpha[inside].min() > 0.8


@pytest.mark.gl
@pytest.mark.parametrize("name", PEOPLE)
def test_light_falls_on_each_from_where_it_is(renderer_of: Callable[..., Renderer], name: str) -> None:
    avatar = person(name)
    for one in (avatar, *(level.content for level in avatar.levels)):
        surface = one.splats.surface
        assert surface is not None and surface.shade is None  # colours are albedo
        assert (np.linalg.norm(surface.normals / 127, axis=1) > 0.97).mean() > 0.99
        assert surface.ao.min() >= 0.24 and np.median(surface.ao) > 0.6 and surface.ao.max() > 0.9
    eyes = avatar.skeleton.joints[[avatar.skeleton.names.index(f"{side}_eye_smplhf") for side in ("left", "right")]]
    middle = eyes.mean(axis=0) + (0, -0.04, 0)
    view = Camera(look_at(middle + (0, 0, 0.8), middle), pinhole(96, 96, 18.0), 96, 96)
    left, right = (
        renderer_of(Scene([Item(avatar)], light=Light.preset(way)), (96, 96)).render([view])[0][..., :3].mean(axis=2)
        for way in ("left", "right")
    )
    cheeks = (left - right)[40:70, 26:40].mean(), (left - right)[40:70, 56:70].mean()
    assert cheeks[0] > 0.03 and cheeks[1] < -0.03  # "left" is the side of the picture


def test_the_one_shown_by_default_is_one_of_them_with_coarser_levels() -> None:
    avatar = default_avatar()
    counts = [len(avatar.splats), *(len(level.content.splats) for level in avatar.levels)]
    assert avatar is person(DEFAULT) and len(counts) > 1 and counts == sorted(set(counts), reverse=True)
    assert avatar.splats.cones is not None and all(one.content.splats.cones is not None for one in avatar.levels)


def test_another_name_is_refused_in_one_line() -> None:
    with pytest.raises(FormatError, match="the embedded people are anna, ben, mei, not 'dora'"):
        person("dora")
    with pytest.raises(GlsplatError, match=r"--avatar dora: no such file, nor an embedded person \(anna, ben or mei\)"):
        load_avatar("dora", "--avatar")


@pytest.mark.extra(name="consent")
def test_commands_take_names_and_files_go_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = os.getcwd()
    os.chdir(tmp_path)
    try:
        assert len(load_avatar("anna", "--avatar").skeleton) == 55
        assert main(["inspect", "ben"]) == 0 and "52" in capsys.readouterr().out
        (tmp_path / "anna").write_bytes(b"not an avatar")
        assert embedded_file("anna") == Path("anna")
        with pytest.raises(GlsplatError):
            load_avatar("anna", "--avatar")
        assert embedded_file("anna.glb") == Path("anna.glb")
    finally:
        os.chdir(before)
