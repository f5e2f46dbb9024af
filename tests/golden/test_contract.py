"""Images of independent float64 code against the renderer, at the gates of docs/conventions.md."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat import reference
from glsplat.camera import Camera, sorting_camera
from glsplat.formats.camera_file import load_cameras
from glsplat.renderer import Renderer
from glsplat.splats import Splats
from tests.compare import Difference, assert_contract
from tests.formats.scenes import load_ply
from tests.golden.stored import CUDA, DATA, HARD, INDEPENDENT, NAMES, cameras_of, image_of, splats_of

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]

# what a driver takes unasked, with both targets, and what GPUs take: instanced quads
WAYS: dict[str, dict[str, Any]] = {
    "32f": {"target": "32f"},
    "16f": {"target": "16f"},
    "quads": {"target": "32f", "shape": "quad", "fetch": "attributes"},
}


def check(renderer_of: Make, scene: Splats, cameras: Sequence[Camera], expected: NDArray[np.float32], way: str) -> None:
    size = cameras[0].width, cameras[0].height
    renderer = renderer_of(scene, size, len(cameras), **WAYS[way])
    image = renderer.render(cameras)
    if way == "quads":
        assert not renderer.variant.triangle and not renderer.variant.pulled
    if way == "16f":
        assert Difference.of(image, expected).psnr >= 50
    else:
        assert_contract(image, expected)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("way", WAYS)
def test_contract(renderer_of: Make, name: str, way: str) -> None:
    check(renderer_of, splats_of(name), cameras_of(name), image_of(name), way)


@pytest.mark.shared
@pytest.mark.parametrize(("name", "scene"), [("plant", "plant"), ("garden_cam0", "garden_splats")])
@pytest.mark.parametrize("way", WAYS)
def test_contract_of_captures(shared_data: Path, renderer_of: Make, name: str, scene: str, way: str) -> None:
    """Scenes that may not be copied, beside the checkout."""
    cameras = load_cameras(shared_data / "goldens" / f"{name}.camera.json")
    expected = np.load(shared_data / "goldens" / f"{name}.contract.npy")[None]
    check(renderer_of, load_ply(shared_data / "splats" / f"{scene}.ply"), cameras, expected, way)


@pytest.mark.parametrize("name", [n for n in INDEPENDENT if not n.endswith("_stereo")])
def test_reference_is_the_contract(name: str) -> None:
    """Two float64 codes, or a CUDA kernel and one: 114 dB or better."""
    difference = Difference.of(reference.render(splats_of(name), cameras_of(name)), image_of(name))
    assert difference.psnr > 110 and difference.mean < 1e-7
    if name in HARD:
        assert difference.maximum < 1e-5


def test_every_file_is_credited() -> None:
    """The first column of CREDITS.md names each file of the folder, or its kind, and nothing that is not there."""
    text = (DATA / "CREDITS.md").read_text(encoding="utf-8")
    rows = [row.split("|")[1] for row in text.splitlines() if row.startswith("| `")]
    named = {name for row in rows for name in re.findall("`([^`]+)`", row)}
    kinds = {name.removeprefix("NAME") for name in named if name.startswith("NAME.")}
    assert kinds == {".camera.json", ".contract.npy.xz"}
    licences = set(re.findall(r"\]\((LICENSE-[a-z-]+)\)", text))
    files = {path.name for path in DATA.iterdir()}
    images = {name + kind for name in NAMES for kind in kinds} - {f"{name}.contract.npy.xz" for name in CUDA}
    assert files == {"CREDITS.md"} | licences | images | {n for n in named if not n.startswith("NAME.")}
    assert sum(len(zlib.compress(path.read_bytes())) for path in DATA.iterdir()) < 4e6  # as git stores them


@pytest.mark.parametrize("layers", ["vertex", "geometry"])
def test_each_eye_is_its_single_render_bit_for_bit(renderer_of: Make, layers: str) -> None:
    cameras, scene = cameras_of("demosthenes_10k_stereo"), splats_of("demosthenes_10k_stereo")
    pair = renderer_of(scene, (256, 256), 2, layers=layers).render(cameras)
    single = renderer_of(scene, (256, 256), 1)
    assert np.abs(pair[0] - pair[1]).max() > 0.1  # the eyes differ, so the comparison can fail
    for eye, camera in enumerate(cameras):
        alone = single.in_order(sorting_camera(cameras), [camera])
        assert np.array_equal(pair[eye], alone[0])


def test_a_shifted_splat_is_noticed(renderer_of: Make) -> None:
    """The gate can fail: one pixel of shift is far outside it."""
    (camera,) = cameras_of("demosthenes_10k")
    moved = replace(camera, K=camera.K + [[0, 0, 1], [0, 0, 0], [0, 0, 0]])
    image = renderer_of(splats_of("demosthenes_10k"), (256, 256)).render([moved])
    assert Difference.of(image, image_of("demosthenes_10k")).psnr < 40
