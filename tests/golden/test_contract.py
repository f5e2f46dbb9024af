"""Images of independent float64 code against the renderer, at the gates of docs/conventions.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glsplat import reference
from glsplat.camera import load_cameras, sorting_camera
from glsplat.formats import load_ply
from glsplat.renderer import Renderer
from tests.compare import Difference, assert_contract

pytestmark = [pytest.mark.gl, pytest.mark.shared]

# (folder, image, scene)
GOLDENS = [
    ("goldens", "demosthenes_10k", "splats/demosthenes_10k.ply"),
    ("goldens", "demosthenes_10k_stereo", "splats/demosthenes_10k.ply"),
    ("goldens", "playbot_lod3", "splats/playbot_lod3.ply"),
    ("goldens", "plant", "splats/plant.ply"),
    ("goldens", "garden_cam0", "splats/garden_splats.ply"),
    *(("stress", name, f"stress/{name}.ply") for name in ("needles", "near_plane", "depth_ties", "huge_coords")),
]


def expected_image(shared_data: Path, folder: str, name: str) -> np.ndarray:
    image = np.load(shared_data / folder / f"{name}.contract.npy")
    return image if image.ndim == 4 else image[None]


@pytest.mark.parametrize(("folder", "name", "scene"), GOLDENS, ids=[g[1] for g in GOLDENS])
@pytest.mark.parametrize("target", ["32f", "16f"])
def test_contract(
    shared_data: Path, renderer_of: Callable[..., Renderer], folder: str, name: str, scene: str, target: str
) -> None:
    cameras = load_cameras(shared_data / folder / f"{name}.camera.json")
    size = cameras[0].width, cameras[0].height
    renderer = renderer_of(load_ply(shared_data / scene), size, len(cameras), target=target)
    image = renderer.render(cameras)
    expected = expected_image(shared_data, folder, name)
    if target == "32f":
        assert_contract(image, expected)
    else:
        assert Difference.of(image, expected).psnr >= 50


@pytest.mark.parametrize("name", ["needles", "near_plane", "depth_ties", "huge_coords"])
def test_reference_is_the_contract(shared_data: Path, name: str) -> None:
    cameras = load_cameras(shared_data / "stress" / f"{name}.camera.json")
    image = reference.render(load_ply(shared_data / "stress" / f"{name}.ply"), cameras)
    assert np.abs(image - expected_image(shared_data, "stress", name)).max() < 1e-5


@pytest.mark.parametrize("layers", ["vertex", "geometry"])
def test_each_eye_is_its_single_render_bit_for_bit(
    shared_data: Path, renderer_of: Callable[..., Renderer], layers: str
) -> None:
    cameras = load_cameras(shared_data / "goldens" / "demosthenes_10k_stereo.camera.json")
    scene = load_ply(shared_data / "splats" / "demosthenes_10k.ply")
    pair = renderer_of(scene, (256, 256), 2, layers=layers).render(cameras)
    single = renderer_of(scene, (256, 256), 1)
    assert np.abs(pair[0] - pair[1]).max() > 0.1  # the eyes differ, so the comparison can fail
    for eye, camera in enumerate(cameras):
        alone = single.render([camera], sort_viewmat=sorting_camera(cameras))
        assert np.array_equal(pair[eye], alone[0])


def test_a_shifted_splat_is_noticed(shared_data: Path, renderer_of: Callable[..., Renderer]) -> None:
    """The gate can fail: one pixel of shift is far outside it."""
    camera = load_cameras(shared_data / "goldens" / "demosthenes_10k.camera.json")[0]
    moved = replace(camera, K=camera.K + [[0, 0, 1], [0, 0, 0], [0, 0, 0]])
    image = renderer_of(load_ply(shared_data / "splats" / "demosthenes_10k.ply"), (256, 256)).render([moved])
    assert Difference.of(image, expected_image(shared_data, "goldens", "demosthenes_10k")).psnr < 40
