"""Edits photographs and captures as people spoil them, and counts what the check says: the tables of docs/photo.md.

    python -m tools.docs.check_results [--photos FOLDER] [--captures p14 p15 ...] [name ...]

FOLDER has photographs and photos.json, which says of each what ought to become of it (whole people: "avatar"). Names
choose among the photographs. Of each edit two rows are printed: of photographs of real people, and of captures of
made-up ones.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from glsplat.extras.authoring.check.capture import Capture, check_capture
from glsplat.extras.authoring.check.photos import check_photos
from glsplat.extras.authoring.networks.people import find_person
from glsplat.extras.authoring.photo.photo_file import Photo, read_photo
from tests.extras.authoring.captures import capture

Image = np.ndarray
Edit = Callable[[Image, dict[str, float], Image], Image]


def _turned(degrees: float) -> Edit:
    """The camera held askew; the picture's corners are mirrored."""

    def edit(picture: Image, at: dict[str, float], other: Image) -> Image:
        height, width = picture.shape[:2]
        turn = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, 0.8)
        return cv2.warpAffine(picture, turn, (width, height), borderMode=cv2.BORDER_REFLECT)

    return edit


def _down_to(joint: str, more: float = 0.0) -> Edit:
    """The picture ends at a joint, or by a share of the height below it."""

    def edit(picture: Image, at: dict[str, float], other: Image) -> Image:
        return picture[: max(round(at[joint] + more * (at["ankle"] - at["nose"])), 8)]

    return edit


def _from(joint: str, less: float) -> Edit:
    """The picture begins at a joint, or by a share of the height above it."""

    def edit(picture: Image, at: dict[str, float], other: Image) -> Image:
        return picture[max(round(at[joint] - less * (at["ankle"] - at["nose"])), 0) :]

    return edit


def _lit(factor: float) -> Edit:
    def edit(picture: Image, at: dict[str, float], other: Image) -> Image:
        return (255 * np.clip((picture / 255.0) ** 2.2 * factor, 0, 1) ** (1 / 2.2)).astype(np.uint8)

    return edit


def _beside(*pictures: Image) -> Image:
    height = min(len(picture) for picture in pictures)
    resized = [cv2.resize(each, (round(each.shape[1] * height / len(each)), height)) for each in pictures]
    return np.hstack(resized)


def _small(picture: Image, at: dict[str, float], other: Image) -> Image:
    scale = 250 / (1.12 * (at["ankle"] - at["nose"]))
    return cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def _smeared(picture: Image, at: dict[str, float], other: Image) -> Image:
    return cv2.GaussianBlur(picture, (0, 0), 0.012 * (at["ankle"] - at["nose"]))


GOOD: dict[str, Edit] = {
    "as it is": lambda picture, at, other: picture,
    "mirrored": lambda picture, at, other: picture[:, ::-1],
    "askew by 10 degrees": _turned(10),
    "ends at the ankles": _down_to("ankle", 0.03),
    "black and white": lambda picture, at, other: np.repeat(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)[..., None], 3, 2),
}
"""Name -> edit, after which an avatar ought to be made."""

BAD: dict[str, Edit] = {
    "ends at the chest": _down_to("shoulder", 0.12),
    "ends at the hips": _down_to("hip"),
    "ends at the thighs": _down_to("hip", 0.15),
    "ends at the knees": _down_to("knee"),
    "ends at the shins": _down_to("knee", 0.12),
    "no head": _from("shoulder", 0.0),
    "forehead cut": _from("nose", 0.02),
    "one half, left of the middle": lambda picture, at, other: picture[:, : round(at["x"])],
    "on its side": lambda picture, at, other: np.rot90(picture),
    "upside down": lambda picture, at, other: picture[::-1, ::-1],
    "askew by 35 degrees": _turned(35),
    "250 pixels high": _small,
    "a fortieth of the light": _lit(1 / 40),
    "eight times the light": _lit(8),
    "out of focus": _smeared,
    "a second person beside": lambda picture, at, other: _beside(picture, other),
    "three beside each other": lambda picture, at, other: _beside(picture, other, picture[:, ::-1]),
    "nobody": lambda picture, at, other: cv2.GaussianBlur(picture, (0, 0), 0.12 * len(picture)),
}
"""Name -> edit, after which the picture ought to be refused."""


def _places(picture: Image) -> dict[str, float]:
    """Rows of nose, shoulders, hips, knees and ankles, and the person's column."""
    person = find_person(picture)
    assert person is not None
    points = person.body.points
    pairs = {"shoulder": 11, "hip": 23, "knee": 25, "ankle": 27}
    rows = {name: float(points[[low, low + 1], 1].mean()) for name, low in pairs.items()}
    return rows | {"nose": float(points[0, 1]), "x": float(points[[11, 12, 23, 24], 0].mean())}


def _framed(picture: Image) -> Capture:
    """The check of the picture with transparent corners, as windows on a desktop have them."""
    alpha = np.full(picture.shape[:2], 255, np.uint8)
    corner = len(picture) // 30
    for rows in (slice(0, corner), slice(-corner, None)):
        alpha[rows, :corner] = alpha[rows, -corner:] = 0
    photo = Photo(picture, None, (picture.shape[1], picture.shape[0]), alpha=alpha)
    return check_photos(photo)["front"].capture


def rows_of(pictures: dict[str, Image]) -> dict[str, list[Capture]]:
    """What the check says of each edit of each picture."""
    names, found = list(pictures), {edit: [] for edit in (*GOOD, "transparent corners", *BAD)}
    for number, name in enumerate(names):
        picture, other = pictures[name], pictures[names[(number + 1) % len(names)]]
        at = _places(picture)
        for edit, made in (GOOD | BAD).items():
            found[edit].append(check_capture(np.ascontiguousarray(made(picture, at, other), np.uint8)))
        found["transparent corners"].append(_framed(picture))
        print(name, flush=True)
    return found


def table(found: dict[str, list[Capture]]) -> str:
    """Edit, how many are refused, and what the refusals and notes are."""
    lines = ["| edit | refused | refusals | notes |", "|---|---|---|---|"]
    for edit, captures in found.items():
        told = [
            Counter(finding.code for seen in captures for finding in seen.findings if finding.refusal == refusal)
            for refusal in (True, False)
        ]
        words = [", ".join(f"{code} {count}" for code, count in each.most_common()) for each in told]
        refused = sum(seen.refused for seen in captures)
        lines.append(f"| {edit} | {refused} of {len(captures)} | {words[0]} | {words[1]} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path)
    parser.add_argument("--captures", nargs="*", default=[])
    parser.add_argument("names", nargs="*")
    given = parser.parse_intermixed_args()
    if given.photos:
        told = json.loads((given.photos / "photos.json").read_text())
        names = given.names or [name for name, facts in told.items() if facts["expected"] == "avatar"]
        print(table(rows_of({name: read_photo(given.photos / name, 1200).picture for name in names})))
    if given.captures:
        print(table(rows_of({name: capture(name).picture for name in given.captures})))


if __name__ == "__main__":
    main()
