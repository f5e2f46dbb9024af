"""Draws the good and the bad captures of docs/photo.md anew, each with what the check says of it.

    python -m tools.docs.captures [docs/images]

The pictures are those of tests/authoring/photo/test_capture.py and tests/authoring/reconstruct/test_robustness.py. Look
at both sheets.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from glsplat.authoring.photo.capture import check_capture
from glsplat.authoring.photo.photo_file import photo_of
from tests.authoring.captures import capture
from tests.authoring.photo.test_capture import BAD
from tests.authoring.reconstruct.test_robustness import EDITS

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
        picture = photo_of(EDITS[name](person)[0]).picture if name in EDITS else person.picture
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
