"""The project's own golden images: small scenes made in code, a PNG and a sidecar that says what rendered it.

Same driver string: within 1/255. Another driver: at most 0.1 % of the pixels beyond 5/255. Another target: 50 dB.
A missing or an unused golden fails. ``make goldens`` writes them anew; refused in CI, and only for pictures somebody
has looked at.

Each says how splats are drawn, so that it is the same on every driver: as triangles that pull their records, which
software rasterizers take unasked (test_paths.py), or ("quads_...") as instanced quads, both eyes in one draw into two
layers, which GPUs take.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
from glsplat.data import default_avatar
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from tests.compare import Difference
from tests.scenes import camera, cloud, eyes, limb, one_splat

pytestmark = pytest.mark.gl

FOLDER = Path(__file__).parent / "images"
FAILED = Path(__file__).resolve().parents[1] / "out"

TRIANGLES = {"shape": "triangle", "fetch": "storage"}
QUADS = {"shape": "quad", "fetch": "attributes"}
TWINS = {"quads_sh3_pair": "sh3_pair", "quads_person": "person"}  # the same scenes drawn both ways

Case = tuple[Any, list[Camera], Pose | None, dict[str, Any]]


def rows() -> Splats:
    """Discs from sub-pixel to half the picture, opaque to faint."""
    x, y = np.meshgrid(np.linspace(-1.2, 1.2, 6), np.linspace(-1, 1, 5))
    means = np.stack([x.ravel(), y.ravel(), 0.01 * np.arange(30)], -1)
    scales = np.geomspace(0.002, 0.3, 6)[np.arange(30) % 6, None] * (1, 0.5, 0.1)
    quats = np.stack([np.cos(np.arange(30) / 5), 0 * np.arange(30), 0 * np.arange(30), np.sin(np.arange(30) / 5)], -1)
    rgb = np.stack([np.linspace(0, 1, 30), np.linspace(1, 0.2, 30), np.full(30, 0.5)], -1)
    return Splats.create(means, quats, scales, np.repeat([1.0, 0.9, 0.5, 0.1, 0.02], 6), rgb=rgb)


def bent_limb(rotation_degree: int) -> tuple[Avatar, Pose]:
    avatar = limb(count=1500, degree=rotation_degree)
    return avatar, Pose(np.array([[0, 0, 0], [0, 0, 0.9], [0.4, 0, 0.9], [0, 0.8, 0.4]]), np.array([-0.6, -0.4, 0]))


def person() -> tuple[list[Camera], Pose]:
    rotations = np.zeros((55, 3))
    rotations[16, 2], rotations[17, 2], rotations[18, 1] = -1.0, 1.1, -0.9
    rotations[1, 0], rotations[4, 0] = -0.6, 0.7
    head = np.eye(4)
    head[:3, 3] = 0.15, 1.0, 2.1
    return list(stereo_cameras(head, 0.3, size=(128, 128), background=(0.2, 0.2, 0.25))), Pose(rotations, np.zeros(3))


def off_centre_pair() -> list[Camera]:
    """fx is not fy, and the principal points lie apart, as in a headset."""
    K = [np.array([[70.0, 0, x], [0, 55, 28], [0, 0, 1]]) for x in (58.3, 37.7)]
    return [replace(view, K=k, width=96, height=64) for view, k in zip(eyes(64), K, strict=True)]


def golden_cases() -> dict[str, Callable[[], Case]]:
    wide = [
        Camera(look_at((1.5, 0.5, 2), (0, 0, 0)), np.array([[60.0, 0, 20], [0, 45, 30], [0, 0, 1]]), 96, 64),
    ]

    def bent(degree: int, views: list[Camera], config: dict[str, Any]) -> Case:
        avatar, pose = bent_limb(degree)
        return avatar, views, pose, config

    return {
        "still": lambda: (rows(), [camera(96)], None, {}),
        "antialias": lambda: (rows(), [camera(96)], None, {"antialias": True}),
        "sh3_pair": lambda: (cloud(800, 3), list(eyes(64)), None, {}),
        "off_centre": lambda: (cloud(800), wide, None, {}),
        "background_pair": lambda: (
            cloud(60),
            [replace(v, background=b) for v, b in zip(eyes(64), [(0.1, 0.4, 0.2), (0.8, 0.3, 0.1)], strict=True)],
            None,
            {},
        ),
        "bent": lambda: bent(0, [camera(96)], {}),
        "bent_sh1_raw": lambda: bent(1, [camera(96)], {"rotation": "raw"}),
        "half_target": lambda: (cloud(1500), [camera(64)], None, {"target": "16f"}),
        "one_pixel_wide": lambda: (
            one_splat(scales=[[0.5, 1e-4, 1e-4]], quats=[[0.9, 0, 0, 0.43]]),
            [Camera(look_at((0, 0, 3), (0, 0, 0)), pinhole(64, 64), 64, 64)],
            None,
            {},
        ),
        "person": lambda: (default_avatar(), *person(), {}),
        "quads_sh3_pair": lambda: (cloud(800, 3), list(eyes(64)), None, {}),
        "quads_off_centre_pair": lambda: (cloud(800, 1), off_centre_pair(), None, {}),
        "quads_antialias_pair": lambda: (rows(), list(eyes(96)), None, {"antialias": True}),
        "quads_bent_sh1_pair": lambda: bent(1, list(eyes(96)), {}),
        "quads_person": lambda: (default_avatar(), *person(), {}),
    }


CASES = golden_cases()


def way_of(name: str, context: Context) -> dict[str, str]:
    """How that golden is drawn, as far as the driver can."""
    way = QUADS if name.startswith("quads_") else TRIANGLES
    return way if context.vertex_storage else way | {"fetch": "attributes"}


def variant_on(context: Context, made: dict[str, int]) -> dict[str, int | str]:
    """The variant of a golden, as another driver has it that lacks what the maker's could do."""
    lacks = {
        "pulled": 0 if not context.vertex_storage else made["pulled"],
        "numbered": int(not context.vertex_ids),
        "geometry": int(made["views"] > 1) if not context.vertex_layers else 0,
    }
    return {"target": "330"} | made | lacks  # the goldens are older than that field


@pytest.mark.parametrize("name", CASES)
def test_golden(
    renderer_of: Callable[..., Renderer], context: Context, name: str, request: pytest.FixtureRequest
) -> None:
    scene, cameras, pose, config = CASES[name]()
    size = cameras[0].width, cameras[0].height
    renderer = renderer_of(scene, size, len(cameras), output="uint8", **way_of(name, context), **config)
    image = np.concatenate(list(renderer.render(cameras, pose)), axis=1)
    picture, sidecar = FOLDER / f"{name}.png", FOLDER / f"{name}.json"
    if request.config.getoption("--update-goldens"):
        if os.environ.get("CI"):
            pytest.fail("goldens are not made in CI; run make goldens on a machine where you can look at them")
        FOLDER.mkdir(exist_ok=True)
        cv2.imwrite(str(picture), cv2.cvtColor(image, cv2.COLOR_RGBA2BGRA))
        facts = {"driver": renderer.driver, "variant": asdict(renderer.variant), "target": renderer.target_dtype}
        sidecar.write_text(json.dumps({**facts, "config": config}, indent=1) + "\n", encoding="utf-8")
        return
    assert picture.exists() and sidecar.exists(), f"no golden {name}: make goldens, and look at it"
    expected = cv2.cvtColor(cv2.imread(str(picture), cv2.IMREAD_UNCHANGED), cv2.COLOR_BGRA2RGBA)
    facts = json.loads(sidecar.read_text(encoding="utf-8"))
    assert variant_on(context, facts["variant"]) == asdict(renderer.variant), "the golden was made by another variant"
    assert image.shape == expected.shape
    error = np.abs(image.astype(int) - expected).max(axis=-1)
    if facts["target"] != renderer.target_dtype:  # as on a GPU; llvmpipe cuts off where GPUs round
        passed = Difference.of(image / 255, expected / 255).psnr >= 50
    else:
        passed = error.max() <= 1 if facts["driver"] == renderer.driver else (error > 5).mean() <= 0.001
    if not passed:
        FAILED.mkdir(exist_ok=True)
        difference = np.repeat(np.clip((error / 255) ** 0.25 * 255, 0, 255).astype(np.uint8)[..., None], 3, axis=-1)
        three = np.concatenate([image[..., :3], expected[..., :3], difference], axis=0)
        cv2.imwrite(str(FAILED / f"{name}.png"), cv2.cvtColor(three, cv2.COLOR_RGB2BGR))
        pytest.fail(f"{name}: max {error.max()}, {(error > 1).mean():.3%} beyond 1/255; see tests/out/{name}.png")


def test_no_golden_is_unused() -> None:
    assert {p.stem for p in FOLDER.iterdir()} == set(CASES)
    assert all((FOLDER / f"{name}{suffix}").exists() for name in CASES for suffix in (".png", ".json"))


def test_goldens_of_both_ways() -> None:
    """Quads in two layers without a geometry shader, all of them pairs; and triangles, pulled."""
    for name in CASES:
        made = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))["variant"]
        way = [made[key] for key in ("triangle", "pulled", "geometry", "numbered")]
        quads = name.startswith("quads_")
        assert way == ([0, 0, 0, 0] if quads else [1, 1, 0, 0]) and (made["views"] == 2 or not quads)


@pytest.mark.parametrize("name", TWINS)
def test_twins_are_one_picture(name: str) -> None:
    """To the last step of 8 bit."""
    quads, triangles = (cv2.imread(str(FOLDER / f"{n}.png"), cv2.IMREAD_UNCHANGED) for n in (name, TWINS[name]))
    assert quads.shape == triangles.shape and np.abs(quads.astype(int) - triangles).max() <= 1
