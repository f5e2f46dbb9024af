"""Light in the page's own drawing: pictures against the desktop's, the surface in the file, and its own numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat import Avatar, Item, Pose, Scene
from glsplat.extras.browser.web_format.read import decode_avatar
from glsplat.extras.browser.web_format.write import encode_avatar
from glsplat.light import Light
from tests import scenes
from tests.browser.draw.conftest import Bench, posed
from tests.browser.draw.test_avatar import PICTURE, eye_of, like
from tests.browser.draw.test_parity import eyes, psnr, thing, truth, turning
from tests.light.lit import random_light, surfaced


def said(light: Light) -> dict[str, Any]:
    return {"sun": None, **light.to_json()}


@pytest.fixture(scope="module")
def person() -> Avatar:
    return surfaced(replace(glsplat.default_avatar().levels[0].content, levels=()), seed=3)


@pytest.mark.parametrize("sun", [True, False])
def test_a_person_in_light(bench: Bench, person: Avatar, sun: bool) -> None:
    light = random_light(21 + sun, sun)
    pose, cameras = turning(person, 2.2), eyes((0.7, 1.3, 2.1), (0, 1, 0))
    scene = Scene([Item(person, pose=pose)], light=light)
    expected = truth(scene, cameras)
    question = {"things": [bench.offer("lit", person)], "poses": [thing(pose)], "kinds": ["32f", "16f"]}
    found = bench.pictures(cameras, light=said(light), **question)
    assert psnr(found["32f"], expected) >= 90 and psnr(found["16f"], expected) >= 60
    if not sun:
        return
    single = bench.pictures(cameras[:1], light=said(light), **question)
    assert psnr(single["32f"], truth(scene, cameras[:1])) >= 90
    plain = bench.pictures(cameras, **question)["32f"]
    assert psnr(plain, truth(Scene([Item(person, pose=pose)]), cameras)) >= 95 and psnr(plain, expected) < 40
    # without a surface it is the program without light
    bare = bench.offer("bare", replace(person, splats=replace(person.splats, surface=None)))
    assert np.array_equal(bench.pictures(cameras, light=said(light), **question | {"things": [bare]})["32f"], plain)


def test_colours_by_direction_flat_and_mirrored_splats_and_what_has_no_surface(bench: Bench) -> None:
    rng = np.random.default_rng(6)
    cloud = scenes.cloud(3000, degree=2, seed=4, spread=0.4)
    scales = np.array(cloud.scales)
    scales[::5, 1] = 0
    scales[1::5, 0] *= -1
    scales[2::5] *= (1, -1, 1)
    lit = surfaced(replace(cloud, scales=scales), seed=2)
    first = Item(lit, transform=glsplat.similarity((0.1, 1.0, -0.3), (0.3, -0.5, 0.2, 0.6), 0.8))
    second = Item(scenes.limb(900, joints=3, degree=0, seed=9), pose=Pose(rng.normal(0, 0.4, (3, 3)), (-0.6, 1, 0)))
    light, cameras = random_light(8), eyes((0.5, 1.4, 2.2), (0, 1, 0))
    expected = truth(Scene([first, second], light=light), cameras)
    names = [bench.offer("first", lit), bench.offer("second", second.content)]  # type: ignore[arg-type]
    poses = [thing(item=first), thing(second.pose)]
    found = bench.pictures(cameras, things=names, poses=poses, kinds=["32f"], light=said(light))
    assert psnr(found["32f"], expected) >= 85


def test_who_is_handed_out_is_lit(bench: Bench, person: Avatar) -> None:
    bench.data["person"] = encode_avatar(person)
    shown = decode_avatar(bench.data["person"]).without("head")
    pose, camera, light = turning(person, 1.9), eyes((0.4, 1.2, 2.4), (0, 1, 0))[0], Light.preset("evening")
    asked = {"name": "person", "pose": posed(pose), "camera": eye_of(camera), "headless": True}
    found = bench.js(PICTURE, {**asked, "light": said(light)})
    like(found, truth(Scene([Item(shown, pose=pose)], light=light), [camera])[0], 85)
