"""The person's mask: found in the picture, or brought by the user."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from PIL import Image

from glsplat.errors import FormatError
from glsplat.extras.authoring.networks.network import Crop
from glsplat.extras.authoring.networks.person import DetectedBody, bounds
from glsplat.extras.authoring.photo.photo_file import decode_photo
from glsplat.extras.authoring.segment import mask as mask_module
from glsplat.extras.authoring.segment.mask import person_mask, read_mask
from tests.extras.authoring.captures import capture, needs_networks


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def made_up() -> tuple[np.ndarray, np.ndarray, np.ndarray, DetectedBody]:
    """Picture, true mask, where the shadow lies, and a body network that sees blocks of nine pixels."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:480, 0:320]
    picture = np.where((y < 360)[..., None], (190, 185, 175), (140, 120, 100)).astype(np.float32)
    shadow = ((x - 190) / 70) ** 2 + ((y - 405) / 14) ** 2 < 1
    dark = cv2.GaussianBlur(shadow.astype(np.float32), (0, 0), 5)
    picture *= 1 - 0.5 * dark[..., None]
    head = ((x - 160) / 22) ** 2 + ((y - 85) / 28) ** 2 < 1
    shirt = (abs(x - 160) < 45) & (y > 110) & (y < 240)
    arms = (abs(abs(x - 160) - 45 - 0.8 * (y - 120)) < 9) & (y > 120) & (y < 220)
    legs = (abs(abs(x - 160) - 22) < 15) & (y >= 240) & (y < 400)
    shoes = (abs(abs(x - 160) - 24) < 20) & (y >= 395) & (y < 412)
    for part, colour in ((arms, (60, 90, 170)), (legs, (40, 45, 60)), (shoes, (120, 30, 30)), (head, (210, 160, 130))):
        picture[part] = colour
    picture[shirt] = np.where((y // 12 % 2)[..., None], (60, 90, 170), (220, 220, 220))[shirt]
    picture = np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)
    true = head | shirt | arms | legs | shoes
    coarse = cv2.resize(true.astype(np.float32), (320 // 9, 480 // 9), interpolation=cv2.INTER_AREA)
    soft = cv2.resize(coarse, (320, 480), interpolation=cv2.INTER_LINEAR)
    soft = np.where((soft < 0.8) & (dark > 0.4), 0.6, soft).astype(np.float32)  # it takes the shadow for a foot
    points = np.full((33, 2), (160.0, 200.0))
    points[27:29] = (138, 392), (182, 392)
    return (
        picture,
        true,
        shadow & ~true,
        DetectedBody(points, np.ones(33), np.zeros((33, 3)), 1.0, soft, Crop(160, 240, 480)),
    )


def test_the_outline_is_found_and_the_shadow_left_out(monkeypatch) -> None:
    picture, true, shadow, body = made_up()
    mask = person_mask(picture, body)
    assert iou(body.mask > 0.5, true) < 0.92
    assert iou(mask, true) > 0.975
    assert (body.mask > 0.5)[shadow].mean() > 0.5 and mask[shadow].mean() < 0.35
    monkeypatch.setattr(mask_module, "_SHADOW_LOG_ODDS", 1e6)
    unaware = person_mask(picture, body)
    assert unaware[shadow].mean() > mask[shadow].mean() + 0.25
    assert cv2.connectedComponents(mask.astype(np.uint8))[0] == 2


def test_the_same_mask_every_time_with_any_number_of_threads() -> None:
    picture, _, _, body = made_up()
    threads = cv2.getNumThreads()
    try:
        masks = []
        for count in (1, 2, 3):
            cv2.setNumThreads(count)
            cv2.setRNGSeed(count)
            masks.append(person_mask(picture, body))
    finally:
        cv2.setNumThreads(threads)
    assert np.array_equal(masks[0], masks[1]) and np.array_equal(masks[0], masks[2])


@pytest.mark.parametrize("box", [(0, 0, 0, 0), (10, 10, 11, 11), (0, 0, 320, 480)])
def test_strange_masks_give_some_mask(box: tuple[int, int, int, int]) -> None:
    picture, _, _, body = made_up()
    body.mask[:] = 0
    body.mask[box[1] : box[3], box[0] : box[2]] = 1
    mask = person_mask(picture, body)
    assert mask.shape == (480, 320) and mask.dtype == bool


def test_bounds() -> None:
    mask = np.zeros((5, 7), bool)
    assert bounds(mask).tolist() == [0, 0, 0, 0]
    mask[1, 2:4] = True
    assert bounds(mask).tolist() == [2, 1, 4, 2]


@pytest.mark.check
@pytest.mark.shared
def test_a_participant() -> None:
    needs_networks()
    from glsplat.extras.authoring.networks.people import find_person

    person = capture("p05")
    found = find_person(person.picture)
    mask = person_mask(person.picture, found.body)
    assert iou(mask, person.mask) > 0.97 and iou(mask, person.mask) > iou(found.body.mask > 0.5, person.mask) + 0.01


def shape(width: int = 60, height: int = 90) -> np.ndarray:
    """True on a block that is not in the middle."""
    mask = np.zeros((height, width), bool)
    mask[height // 9 : height // 2, width // 6 : width // 2] = True
    return mask


def picture(width: int = 60, height: int = 90, **options: object) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (width, height), (90, 120, 60)).save(out, "JPEG", **options)
    return out.getvalue()


PHOTO = decode_photo(picture())
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
        ("a.png", GREY.convert("P"), {}),
        ("a.png", CLEAR, {}),
        ("a.webp", CLEAR, {"lossless": True}),
        ("a.png", GREY.rotate(90, expand=True), {"exif": TURNED}),
        ("a.png", Image.fromarray((shape() * 65535).astype(np.uint16)), {}),
    ],
)
def test_every_way_to_draw_one(tmp_path, name, image, options) -> None:
    image.save(tmp_path / name, **options)
    assert np.array_equal(read_mask(tmp_path / name, PHOTO), shape())


def test_a_mask_shrinks_with_its_picture(tmp_path) -> None:
    small = decode_photo(picture(600, 900), side=90)
    Image.fromarray((shape(600, 900) * 255).astype(np.uint8)).save(tmp_path / "a.png")
    found = read_mask(tmp_path / "a.png", small)
    assert found.shape == small.picture.shape[:2] == (90, 60) and (found != shape()).mean() < 0.01


def test_an_array_is_taken_as_it_is() -> None:
    assert read_mask(shape(), PHOTO) is not None
    for wrong in (shape(61), shape() * 1.0, shape()[None]):
        with pytest.raises(FormatError, match=r"a mask needs booleans \(90, 60\), one for each pixel, not"):
            read_mask(wrong, PHOTO)


def test_what_does_not_belong_is_one_line(tmp_path) -> None:
    path = tmp_path / "a.png"
    Image.fromarray((shape(90, 60) * 255).astype(np.uint8)).save(path)
    with pytest.raises(FormatError, match=r"a.png: the mask has 90 x 60 pixels, its picture 60 x 90 \(upright\)"):
        read_mask(path, PHOTO)
    for value, share in ((0, "0.0%"), (255, "100.0%")):
        Image.new("L", (60, 90), value).save(path)
        with pytest.raises(FormatError, match=f"a.png: {share} of the mask are white, which is not a person"):
            read_mask(path, PHOTO)
    path.write_bytes(b"nonsense")
    with pytest.raises(FormatError, match="expected a photograph"):
        read_mask(path, PHOTO)
    with pytest.raises(FormatError, match="cannot be read"):
        read_mask(tmp_path / "absent.png", PHOTO)
