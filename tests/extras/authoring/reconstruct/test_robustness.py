"""A small capture at low quality makes an avatar that looks like its person, the same from two threads."""

from __future__ import annotations

import io
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from glsplat.avatar import Avatar
from glsplat.extras.authoring.check.capture import check_capture
from glsplat.extras.authoring.photo.photo_file import decode_photo
from glsplat.extras.authoring.reconstruct.builtin import Builtin
from glsplat.extras.authoring.reconstruct.reconstructor import Options, Picture
from glsplat.formats import save
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from tests.extras.authoring.captures import capture, needs_networks

SPLATS, HEIGHT = 8_000, 1.66


def made(data: bytes) -> Avatar:
    photo = decode_photo(data)
    seen = check_capture(photo.picture)
    assert not seen.findings
    pictures = {"front": Picture(photo.picture, photo.focal, seen.person)}
    return Builtin().reconstruct(pictures, {"front": seen.mask}, Options(height=HEIGHT, splats=SPLATS, steps=0))


@pytest.mark.check
@pytest.mark.shared
def test_a_small_file_of_low_quality(tmp_path: Path, renderer_of: Callable[..., Renderer]) -> None:
    needs_networks()
    person, out = capture("p01"), io.BytesIO()
    small = cv2.resize(person.picture, (640, 960), interpolation=cv2.INTER_AREA)
    Image.fromarray(small).save(out, "JPEG", quality=40)
    with ThreadPoolExecutor(2) as threads:
        avatar, again = threads.map(made, [out.getvalue()] * 2)
    for name, one in (("a.glb", avatar), ("b.glb", again)):
        save(one, tmp_path / name)
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()

    assert abs(len(avatar.splats) - SPLATS) <= SPLATS // 1000 and avatar.splats.finite().all()
    size = (256, 384)
    camera, pose = person.camera.resized(*size), Pose(person.pose, person.trans)
    drawn = renderer_of(avatar, size=size, views=1).render([camera], pose)[0]
    solid = cv2.resize(person.mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    both = solid & (drawn[..., 3] > 0.5)
    assert both.sum() / (solid | (drawn[..., 3] > 0.5)).sum() > 0.85
    seen = cv2.resize(person.picture, size, interpolation=cv2.INTER_AREA) / 255
    away = cv2.blur(drawn[..., :3], (9, 9)) - cv2.blur(seen.astype(np.float32), (9, 9))
    assert np.abs(away[cv2.erode(both.astype(np.uint8), np.ones((9, 9))) > 0]).mean() < 0.06
