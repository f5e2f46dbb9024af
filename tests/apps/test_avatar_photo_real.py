"""``glsplat avatar photo`` on captures: the avatar is one like any other, and says what it was made from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import apps.cli as cli
from glsplat.camera import Camera, look_at, pinhole
from glsplat.data import default_avatar
from glsplat.formats import load
from glsplat.motion.loading import load_embedded_motion
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from tests.authoring.captures import needs_networks

pytestmark = [pytest.mark.shared, pytest.mark.check]

NAME, HEIGHT = "p04", 1.84


@pytest.fixture(scope="module")
def made(shared_data, tmp_path_factory) -> Path:
    needs_networks()
    out = tmp_path_factory.mktemp("photo") / "me.glb"
    picture = shared_data / "participants" / "capture" / f"{NAME}.jpg"
    words = ["avatar", "photo", picture, "-o", out, "--height", HEIGHT, "--splats", 8_000, "--steps", 10]
    assert cli.main([*map(str, words), "--consent", "made up", "--debug", str(out.parent / "sheets")]) == 0
    return out


def test_it_says_what_it_is(made) -> None:
    meta = load(made).meta
    assert meta["source"] == "1 photograph (front)" and meta["consent"] == "made up"
    assert 0.5 < meta["unseen"] < 0.75
    assert not any(str(part) in json.dumps(meta) for part in (NAME, made.parent))
    assert len(list((made.parent / "sheets").glob("*.png"))) == 1


def test_its_size_and_place(made, shared_data) -> None:
    avatar = load(made)
    points = avatar.splats.means
    truth = np.load(shared_data / "participants" / f"{NAME}.npz")
    assert points[:, 1].min() == pytest.approx(0, abs=0.03)
    assert np.ptp(points[:, 1]) == pytest.approx(np.ptp(truth["vertices"][:, 1]), rel=0.02)
    away = (avatar.skeleton.joints - truth["joints"])[:22]
    assert np.linalg.norm(away - away[0], axis=1).mean() < 0.035
    assert avatar.skeleton.names == default_avatar().skeleton.names


@pytest.mark.gl
def test_it_moves_and_turns_its_eyes(made) -> None:
    avatar = load(made)
    eye = Camera(look_at([0, 1.66, 0.9], [0, 1.66, 0]), pinhole(256, 256, 20.0), 256, 256)
    whole = Camera(look_at([0, 1, 4.5], [0, 1, 0]), pinhole(128, 128, 30.0), 128, 128)
    with Renderer(avatar, size=(256, 256), views=1) as renderer:
        rest = renderer.render([eye], Pose.zero(55))[0].copy()
        rotations = np.zeros((55, 3))
        rotations[[23, 24]] = (0, 0.4, 0)
        turned = renderer.render([eye], Pose(rotations))[0].astype(int)
    changed = np.abs(turned - rest).max(axis=2) > 40
    assert 5 < changed.sum() < 1500  # the irises, and nothing else
    walk = load_embedded_motion("walk", avatar.skeleton)
    with Renderer(avatar, size=(128, 128), views=1) as renderer:
        frames = [renderer.render([whole], walk.at(t))[0].astype(int) for t in (0.0, 0.5)]
    assert all((frame[..., 3] > 200).sum() > 400 for frame in frames)
    assert np.abs(frames[0] - frames[1]).mean() > 0.3


@pytest.mark.gl
def test_it_looks_like_its_person(made, shared_data, capsys) -> None:
    mesh = shared_data / "participants" / f"{NAME}.npz"
    words = ["avatar", "score", made, "--mesh", mesh, "--poses", 1, "--views", 1, "--size", 256, "--json"]
    assert cli.main(list(map(str, words))) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["body_psnr"]["mean"] > 12 and facts["ssim"]["mean"] > 0.85  # the mesh has no light
