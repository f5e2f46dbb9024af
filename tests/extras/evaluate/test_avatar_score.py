"""``glsplat avatar score``: its figures on pictures whose difference is known, and the default avatar's."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import apps.cli as cli
from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.evaluate.avatar_score import DISTANCE, FILL, camera_around, compare, score
from glsplat.extras.formats.person import read_person
from glsplat.renderer import Renderer

WHOLE = (slice(None), slice(None))


def test_figures_of_known_differences(rng):
    wanted = rng.random((60, 50, 3), np.float32) * 0.5
    body, hand = (slice(10, 50), slice(10, 40)), (slice(20, 30), slice(15, 25))
    picture = wanted.copy()
    picture[hand] += 0.1
    dark, bright, ssim = compare(picture, wanted, body, [hand])
    assert bright == pytest.approx(20, abs=1e-3)  # -20 log10 0.1
    assert dark == pytest.approx(20 + 10 * np.log10(40 * 30 / 100), abs=1e-3)
    assert 0.5 < ssim < 1
    picture[:5] = 1  # beyond the boxes and the window of SSIM
    assert compare(picture, wanted, body, [hand])[:2] == pytest.approx((dark, bright))
    assert compare(wanted, wanted, body, [])[1:] == (None, pytest.approx(1))


def test_the_figure_fills_the_picture(rng):
    points = rng.normal(0, (0.3, 0.6, 0.2), (500, 3)) + (0, 1, 0)
    for azimuth in (0, 77, 180):
        camera = camera_around(points, azimuth, 200, 0.5)
        seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        pixel = (seen @ camera.K.T)[:, :2] / seen[:, 2:]
        assert np.abs(pixel - 100).max() == pytest.approx(FILL * 100)
        assert camera.background == (0.5,) * 3
        centre = (points.max(axis=0) + points.min(axis=0)) / 2
        assert np.linalg.norm(camera.position - centre) == pytest.approx(DISTANCE)
    assert camera_around(points, 0, 200).position[2] > 2 and camera_around(points, 90, 200).position[0] > 2


@pytest.mark.gl
@pytest.mark.shared
def test_default_avatar_looks_like_its_mesh(shared_data: Path, context):
    """The gates of the avatar: 30 dB over the body, 24 dB over the hands, SSIM 0.95; two poses here."""
    mesh, avatar = read_person(shared_data / "people" / "char_c_registry.npz"), default_avatar()
    with (
        context.ctx,
        MeshTruth(mesh, size=(512, 512), output="float32", context=context) as truth,
        Renderer(
            avatar, size=(512, 512), config=RenderConfig(output="float32", antialias=True), context=context
        ) as renderer,
    ):
        scores = list(score(renderer, truth, avatar, mesh, ["T-pose", "hands on hips"], 1))
        for s in scores:
            assert s.body >= 30 and s.hands >= 24 and s.ssim >= 0.95, (s.pose, s.body, s.hands, s.ssim)
        moved = replace(avatar.splats, means=avatar.splats.means + np.float32(0.008))
        renderer.load(replace(avatar, splats=moved))  # and they can fail
        worse = next(score(renderer, truth, avatar, mesh, ["T-pose"], 1))
        assert worse.body < 30 and worse.body < scores[0].body - 3


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.shared
def test_the_command(shared_data: Path, tmp_path, capsys):
    sheet = tmp_path / "s.png"
    words = ["--size", "128", "--poses", "1", "--views", "2", "--sheet", str(sheet), "--cull-hidden", "--json"]
    assert cli.main(["avatar", "score", "--mesh", str(shared_data / "people" / "char_c_registry.npz"), *words]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["pictures"] == len(facts["each"]) == 2 and facts["drawn"] < facts["splats"]
    assert facts["body_psnr"]["min"] == pytest.approx(min(e["body_psnr"] for e in facts["each"]), abs=0.01)
    assert {e["azimuth"] for e in facts["each"]} == {15, 195} and facts["face_psnr"]["min"] > 20
    assert cv2.imread(str(sheet)).shape == (66 - 2, 6 * 66 - 2, 3) and 30 < facts["finest_psnr"]["min"] < 80
