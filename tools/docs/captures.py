"""Draws the good and the bad captures of docs/photo.md anew, each with what the check says of it.

    python -m tools.docs.captures [docs/images]

The bad ones are those of tests/extras/authoring/check/test_capture.py. Look at both sheets.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from glsplat.extras.authoring.check.capture import check_capture
from glsplat.extras.authoring.photo.photo_file import decode_photo
from tests.extras.authoring.captures import Capture, capture
from tests.extras.authoring.check.test_capture import BAD

TILE, CAPTION, COLUMNS = (190, 270), 20, 6
GOOD = {
    "p03": "as it is",
    "p02": "mirrored",
    "p05": "busy room",
    "p08": "light from the side",
    "p10": "tilted by 5 degrees",
    "p01": "640 x 960, quality 40",
}
FAULTS = (
    "no feet",
    "no hand",
    "far away",
    "two people",
    "half turned",
    "from behind",
    "arms down",
    "blurred",
    "shaken",
    "too bright",
    "too dark",
    "on its side",
)


def packed(picture: np.ndarray, quality: int = 92, **options: object) -> bytes:
    out = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture, np.uint8)).save(out, "JPEG", quality=quality, **options)
    return out.getvalue()


def small(person: Capture) -> tuple[bytes, np.ndarray]:
    """640 x 960 at quality 40."""
    return packed(cv2.resize(person.picture, (640, 960), interpolation=cv2.INTER_AREA), 40), person.picture


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
    "p05": other_room,
    "p08": side_light,
    "p10": tilted,
}


def tile(picture: np.ndarray, caption: str) -> np.ndarray:
    """The whole picture on grey, its caption below."""
    width, height = TILE
    scale = min(width / picture.shape[1], height / picture.shape[0])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    down, right = (height - small.shape[0]) // 2, (width - small.shape[1]) // 2
    whole = np.full((height + CAPTION, width, 3), 235, np.uint8)
    whole[down : down + small.shape[0], right : right + small.shape[1]] = small
    cv2.putText(whole, caption, (4, height + 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (30, 30, 30), 1, cv2.LINE_AA)
    return np.pad(whole, ((0, 0), (2, 2), (0, 0)), constant_values=255)


def sheet(path: Path, tiles: list[np.ndarray]) -> None:
    rows = [np.hstack(tiles[index : index + COLUMNS]) for index in range(0, len(tiles), COLUMNS)]
    cv2.imwrite(str(path), np.vstack(rows)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 84])
    print(path, path.stat().st_size // 1024, "kB")


def main(folder: Path) -> None:
    good = []
    for name, caption in GOOD.items():
        person = capture(name)
        picture = decode_photo(EDITS[name](person)[0]).picture if name in EDITS else person.picture
        findings = check_capture(picture).findings
        assert not findings, (name, findings)
        good.append(tile(picture, caption))
    sheet(folder / "photo-good.jpg", good)
    bad = []
    for name in FAULTS:
        _, edit = BAD[name]
        picture = np.ascontiguousarray(edit(capture("p01"), capture("p02")))
        found = check_capture(picture).findings
        words = [f"{finding.code}{'' if finding.refusal else ' (note)'}" for finding in found]
        bad.append(tile(picture, ", ".join(words)))
    sheet(folder / "photo-bad.jpg", bad)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images"))
