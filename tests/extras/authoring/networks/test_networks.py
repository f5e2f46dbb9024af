"""The networks' readers: crops and their points, and on participants how near the landmarks lie to the truth."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.errors import GlsplatError
from glsplat.extras.authoring.geometry.raster import mesh_picture
from glsplat.extras.authoring.networks import face, people
from glsplat.extras.authoring.networks.network import Crop, Network, sigmoid
from glsplat.extras.authoring.networks.people import find_person
from glsplat.extras.authoring.networks.person import DetectedBody
from glsplat.skinning.pose import Pose
from tests.extras.authoring.captures import capture, needs_networks

LIMBS = [
    f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
]
KNUCKLES = {"index_mcp": "index1", "index_pip": "index2", "middle_mcp": "middle1", "pinky_mcp": "pinky1"}


@pytest.mark.parametrize("crop", [Crop(50, 40, 64), Crop(50, 40, 40, 0.3), Crop(50, 40, 60, -2.0), Crop(10, 5, 90)])
def test_a_crop_shows_what_lies_in_its_square(crop: Crop) -> None:
    """Red and green say where a pixel is; so the crop's pixels say where they came from."""
    y, x = np.mgrid[0:80, 0:100]
    picture = np.stack([2 * x, 2 * y, 0 * x], -1).astype(np.uint8)
    cut = crop.cut(picture, 32)
    v, u = np.mgrid[0:32, 0:32] + 0.5
    came = crop.to_picture(np.stack([u, v], -1), 32)
    inside = (came > 1).all(-1) & (came < (99, 79)).all(-1)
    assert inside.sum() > 100
    assert np.abs(cut[inside][:, :2] / 2 + 0.5 - came[inside]).max() < 0.6


def test_a_large_crop_is_averaged_and_stays_in_place() -> None:
    y, x = np.mgrid[0:800, 0:1000]
    picture = np.stack([x / 4, y / 4, 255 * (x % 2)], -1).astype(np.uint8)
    cut = Crop(500, 400, 700).cut(picture, 64).astype(float)
    assert np.abs(cut[..., 2] - 127).max() < 8  # stripes one pixel wide
    v, u = np.mgrid[0:64, 0:64] + 0.5
    came = Crop(500, 400, 700).to_picture(np.stack([u, v], -1), 64)
    assert np.abs(cut[..., :2] * 4 + 2 - came).max() < 5


def test_paste_is_the_way_back() -> None:
    crop = Crop(50, 40, 40, 0.3)
    values = np.ones((16, 16), np.float32)
    values[:8] = 0.5
    full = crop.paste(values, (80, 100))
    assert full[40, 50] == pytest.approx(0.75, abs=0.15) and full[0, 0] == 0
    assert full[46, 48] == 1 and full[34, 52] == 0.5
    assert full.sum() == pytest.approx(0.75 * 40 * 40, rel=0.03)


def test_sigmoid() -> None:
    assert sigmoid(np.array([-1e4, 0, 1e4], np.float32)).tolist() == [0, 0.5, 1]


def test_without_the_files_it_says_how_to_get_them(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("GLSPLAT_MODELS", str(tmp_path))
    with pytest.raises(GlsplatError, match="the network is not on this machine; run: glsplat models get"):
        Network("face_landmark")
    with pytest.raises(GlsplatError, match="nosuch: no such model; there are selfie_segmentation, pose"):
        Network("nosuch")


@pytest.mark.shared
def test_landmarks_lie_where_the_joints_are() -> None:
    """p03's hair hides an eye: the body network alone takes her for one seen from behind."""
    needs_networks()
    true = capture("p03")
    found = find_person(true.picture)
    assert found is not None and abs(found.turn) < 0.25
    height = np.ptp(np.flatnonzero(true.mask.any(axis=1)))
    errors = [np.linalg.norm(found.body.point(limb) - true.joint(limb)) / height for limb in LIMBS]
    assert np.mean(errors) < 0.025
    for side, read in (("left", found.left_hand), ("right", found.right_hand)):
        assert read.presence > 0.7
        apart = [
            np.linalg.norm(read.points[people.HAND_LANDMARKS.index(mark)] - true.joint(f"{side}_{joint}"))
            for mark, joint in KNUCKLES.items()
        ]
        assert np.mean(apart) < 0.012 * height
    assert found.face.presence > 0.9
    eye = face.eye_of(true.picture, found.face, "left")
    assert np.linalg.norm(eye.iris[0] - true.joint("left_eye_smplhf")) < 4
    again = find_person(true.picture)
    assert again is not None and np.array_equal(again.body.points, found.body.points)


@pytest.mark.shared
def test_a_fringe_over_an_eye_is_a_front_on_a_plain_wall_too() -> None:
    needs_networks()
    true = capture("p03")
    drawn = mesh_picture(true.mesh, true.mesh.posed(Pose(true.pose, true.trans)), true.camera, 1)
    rgba = np.rint(255 * drawn).astype(np.uint8)
    picture = np.where(rgba[..., 3:] > 127, rgba[..., :3], 205).astype(np.uint8)
    found = find_person(picture)
    assert found is not None and abs(found.turn) < np.radians(20)  # farther would be noted


@pytest.mark.parametrize(
    ("sure", "eyes", "elsewhere"), [(0.97, 0, True), (0.97, 1, True), (0.97, 2, False), (0.4, 0, False)]
)
def test_a_face_without_eyes_is_looked_for_nearby(
    sure: float, eyes: int, elsewhere: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stand-ins: the first crop shows hardly a face, a later one is ``sure``; 20 pixels lower there is a masked one."""
    points = np.zeros((33, 2))
    points[:11] = np.column_stack([np.linspace(80, 120, 11), np.full(11, 100)])
    body = DetectedBody(points, np.ones(33), np.zeros((33, 3)), 1.0, np.ones((2, 2), np.float32), Crop(0, 0, 1))
    lower = 100 - 0.1 * 40 + 10

    def look(picture: np.ndarray, crop: Crop) -> face.Face:
        presence = 0.6 if crop.y > lower and crop.side == 88 else sure if crop.side < 88 else 0.1
        return face.Face(np.zeros((468, 3)), presence, crop)

    monkeypatch.setattr(face, "_face_in", look)
    monkeypatch.setattr(face, "visible_eyes", lambda picture, found: 2 if found.presence == 0.6 else eyes)
    found = face.find_face(np.zeros((8, 8, 3), np.uint8), body)
    assert found.displaced == elsewhere
    assert (found.crop.y > lower and found.presence == 0.6) if elsewhere else found.presence == sure
    monkeypatch.setattr(face, "visible_eyes", lambda picture, found: min(eyes, 1))
    doubted = face.find_face(np.zeros((8, 8, 3), np.uint8), body)
    assert (doubted.presence == sure if eyes else doubted.presence < 0.5) and not doubted.displaced
