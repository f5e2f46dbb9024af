"""Masks that users bring: files in all ways to draw one, arrays, and what does not belong to the picture."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from glsplat.authoring.photo.mask_file import mask_of
from glsplat.authoring.photo.photo_file import photo_of
from glsplat.errors import FormatError


def shape(width: int = 60, height: int = 90) -> np.ndarray:
    """True on a block that is not in the middle."""
    mask = np.zeros((height, width), bool)
    mask[height // 9 : height // 2, width // 6 : width // 2] = True
    return mask


def picture(width: int = 60, height: int = 90, **options: object) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (width, height), (90, 120, 60)).save(out, "JPEG", **options)
    return out.getvalue()


PHOTO = photo_of(picture())
GREY = Image.fromarray((shape() * 255).astype(np.uint8))
CLEAR = Image.fromarray(np.dstack([np.full((90, 60, 3), 80), shape() * 255]).astype(np.uint8))
TURNED = Image.Exif()
TURNED[0x0112] = 6  # as stored it has to be turned to the right


@pytest.mark.parametrize(
    ("name", "image", "options"),
    [
        ("a.png", GREY, {}),
        ("a.jpg", GREY, {"quality": 90}),
        ("a.png", GREY.convert("1"), {}),
        ("a.png", GREY.convert("RGB"), {}),
        ("a.png", GREY.convert("P"), {}),
        ("a.png", CLEAR, {}),
        ("a.webp", CLEAR, {"lossless": True}),
        ("a.png", GREY.rotate(90, expand=True), {"exif": TURNED}),
        ("a.jpg", GREY.rotate(90, expand=True), {"exif": TURNED, "quality": 90}),
        ("a.png", Image.fromarray((shape() * 65535).astype(np.uint16)), {}),
    ],
)
def test_every_way_to_draw_one(tmp_path, name, image, options) -> None:
    image.save(tmp_path / name, **options)
    assert np.array_equal(mask_of(tmp_path / name, PHOTO), shape())


def test_a_mask_shrinks_with_its_picture(tmp_path) -> None:
    small = photo_of(picture(600, 900), side=90)
    Image.fromarray((shape(600, 900) * 255).astype(np.uint8)).save(tmp_path / "a.png")
    found = mask_of(tmp_path / "a.png", small)
    assert found.shape == small.picture.shape[:2] == (90, 60) and (found != shape()).mean() < 0.01


def test_an_array_is_taken_as_it_is() -> None:
    assert mask_of(shape(), PHOTO) is not None
    for wrong in (shape(61), shape() * 1.0, shape()[None]):
        with pytest.raises(FormatError, match=r"a mask needs booleans \(90, 60\), one for each pixel, not"):
            mask_of(wrong, PHOTO)


def test_what_does_not_belong_is_one_line(tmp_path) -> None:
    path = tmp_path / "a.png"
    Image.fromarray((shape(90, 60) * 255).astype(np.uint8)).save(path)
    with pytest.raises(FormatError, match=r"a.png: the mask has 90 x 60 pixels, its picture 60 x 90 \(upright\)"):
        mask_of(path, PHOTO)
    for value, share in ((0, "0.0%"), (255, "100.0%")):
        Image.new("L", (60, 90), value).save(path)
        with pytest.raises(FormatError, match=f"a.png: {share} of the mask are white, that is no person"):
            mask_of(path, PHOTO)
    path.write_bytes(b"nonsense")
    with pytest.raises(FormatError, match="expected a photograph"):
        mask_of(path, PHOTO)
    with pytest.raises(FormatError, match="cannot be read"):
        mask_of(tmp_path / "absent.png", PHOTO)
