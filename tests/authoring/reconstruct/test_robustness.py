"""Captures as people send them: each passes the check and gives an avatar that looks like its person."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from glsplat.authoring.photo.capture import check_capture
from glsplat.authoring.photo.photo_file import photo_of
from glsplat.authoring.reconstruct.builtin import Builtin
from glsplat.authoring.reconstruct.reconstructor import Options, Picture
from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.formats import save
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES
from tests.authoring.captures import Capture, capture, needs_networks

pytestmark = [pytest.mark.shared, pytest.mark.check]

SPLATS = 8_000


def packed(picture: np.ndarray, quality: int = 92, **options: object) -> bytes:
    out = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture, np.uint8)).save(out, "JPEG", quality=quality, **options)
    return out.getvalue()


def made(data: bytes, height: float | None = None, splats: int = SPLATS) -> Avatar:
    photo = photo_of(data)
    seen = check_capture(photo.picture)
    assert seen.good, seen.findings
    pictures = {"front": Picture(photo.picture, photo.focal, seen.person)}
    return Builtin().reconstruct(pictures, {"front": seen.mask}, Options(height=height, splats=splats, steps=0))


def height_of(folder: Path, name: str) -> float:
    people = json.loads((folder / "participants" / "participants.json").read_text())["participants"]
    return next(float(person["height_m"]) for person in people if person["id"] == name)


# what was done to the capture -> the file, and the picture it should look like


def small(person: Capture) -> tuple[bytes, np.ndarray]:
    """640 x 960 at quality 40."""
    return packed(cv2.resize(person.picture, (640, 960), interpolation=cv2.INTER_AREA), 40), person.picture


def phone(person: Capture) -> tuple[bytes, np.ndarray]:
    """Twelve megapixels, stored on its side."""
    exif = Image.Exif()
    exif[0x0112] = 6
    return packed(np.rot90(cv2.resize(person.picture, (2832, 4248))), 85, exif=exif), person.picture


def mirrored(person: Capture) -> tuple[bytes, np.ndarray]:
    """As many phones store the picture of their front camera."""
    return packed(person.picture[:, ::-1]), person.picture[:, ::-1]


def other_room(person: Capture) -> tuple[bytes, np.ndarray]:
    """Shelves of books instead of the wall."""
    books = np.random.default_rng(5).integers(20, 230, (9, 60, 3)).astype(np.float32)
    room = cv2.resize(books, person.picture.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    soft = cv2.GaussianBlur(person.mask.astype(np.float32), (0, 0), 0.8)[..., None]
    return packed(soft * person.picture + (1 - soft) * cv2.GaussianBlur(room, (0, 0), 1.5)), person.picture


def side_light(person: Capture) -> tuple[bytes, np.ndarray]:
    """From 40 % of the light to 160 % across the person."""
    left, right = np.flatnonzero(person.mask.any(axis=0))[[0, -1]]
    ramp = np.interp(np.arange(person.picture.shape[1]), (left, right), (0.4, 1.6))[None, :, None]
    lit = 255 * np.clip((person.picture / 255.0) ** 2.2 * ramp, 0, 1) ** (1 / 2.2)
    return packed(lit), lit.astype(np.uint8)


def tilted(person: Capture) -> tuple[bytes, np.ndarray]:
    """The camera held five degrees off the level, a little farther away."""
    height, width = person.picture.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 5, 0.9)
    return packed(cv2.warpAffine(person.picture, turn, (width, height), borderMode=cv2.BORDER_REFLECT)), person.picture


EDITS: dict[str, Callable[[Capture], tuple[bytes, np.ndarray]]] = {
    "p01": small,
    "p02": mirrored,
    "p04": phone,
    "p05": other_room,
    "p08": side_light,
    "p10": tilted,
}


def in_a_mirror(camera: Camera, pose: Pose) -> tuple[Camera, Pose]:
    """World and picture exchanged left for right."""
    sides = {"left": "right", "right": "left"}
    swapped = ["_".join([sides.get(word, word) for word in name.split("_")]) for name in JOINT_NAMES]
    rotations = (pose.rotations * (1, -1, -1))[[JOINT_NAMES.index(name) for name in swapped]]
    across = np.diag([-1.0, 1, 1, 1])
    return replace(camera, viewmat=across @ camera.viewmat @ across), Pose(rotations, pose.trans * (-1, 1, 1))


@pytest.mark.parametrize("name", EDITS)
def test_an_avatar_that_looks_like_its_person(
    shared_data: Path, renderer_of: Callable[..., Renderer], name: str
) -> None:
    needs_networks()
    person = capture(name)
    data, picture = EDITS[name](person)
    avatar = made(data, height_of(shared_data, name))
    assert abs(len(avatar.splats) - SPLATS) <= SPLATS // 1000
    for values in (avatar.splats.means, avatar.splats.scales, avatar.splats.opacities, avatar.splats.sh):
        assert np.isfinite(values).all()

    mask, size = person.mask, (256, 384)
    camera, pose = person.camera.resized(*size), Pose(person.pose, person.trans)
    if EDITS[name] is mirrored:
        mask, (camera, pose) = mask[:, ::-1], in_a_mirror(camera, pose)
    drawn = renderer_of(avatar, size=size, views=1).render([camera], pose)[0]
    solid = cv2.resize(np.ascontiguousarray(mask, np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    both = solid & (drawn[..., 3] > 0.5)
    assert both.sum() / (solid | (drawn[..., 3] > 0.5)).sum() > 0.85
    seen = cv2.resize(np.ascontiguousarray(picture), size, interpolation=cv2.INTER_AREA) / 255
    away = cv2.blur(drawn[..., :3], (9, 9)) - cv2.blur(seen.astype(np.float32), (9, 9))
    assert np.abs(away[cv2.erode(both.astype(np.uint8), np.ones((9, 9))) > 0]).mean() < 0.06


def test_the_same_bytes_from_two_threads(shared_data: Path, tmp_path: Path) -> None:
    needs_networks()
    data = small(capture("p09"))[0]

    def file_of(name: str) -> bytes:
        save(made(data, splats=2_000), str(tmp_path / name))
        return (tmp_path / name).read_bytes()

    with ThreadPoolExecutor(2) as threads:
        first, again = threads.map(file_of, ("a.glb", "b.glb"))
    assert first == again
