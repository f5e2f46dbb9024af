"""The check of a capture: good pictures pass, each fault is named; pictures are participants' captures, edited."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from glsplat.extras.authoring.check.capture import blur_of, check_capture, is_outline
from glsplat.extras.authoring.photo.photo_file import read_photo
from glsplat.skinning.pose import Pose
from tests.extras.authoring.captures import Capture, capture, needs_networks

Edit = Callable[[Capture, Capture], np.ndarray]


def rows(person: Capture) -> tuple[int, int]:
    used = np.flatnonzero(person.mask.any(axis=1))
    return int(used[0]), int(used[-1])


def light(picture: np.ndarray, factor: float) -> np.ndarray:
    return (255 * np.clip((picture / 255.0) ** 2.2 * factor, 0, 1) ** (1 / 2.2)).astype(np.uint8)


def jpeg(picture: np.ndarray, quality: int) -> np.ndarray:
    _, data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def small(picture: np.ndarray, factor: float) -> np.ndarray:
    return cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)


def level(person: Capture, joint: str, other: str = "pelvis", share: float = 0.0) -> int:
    """A row of the picture: at a joint, or so far on the way to another."""
    return int((1 - share) * person.joint(joint)[1] + share * person.joint(other)[1])


def arms(degrees: float) -> dict[str, tuple[float, float, float]]:
    turn = np.radians(degrees)
    return {"left_shoulder": (0, 0, -turn), "right_shoulder": (0, 0, turn)}


def askew(picture: np.ndarray, degrees: float) -> np.ndarray:
    """The picture turned about its middle, with room around it."""
    wide = framed(picture, 0.7, 150, 150, 400, 400)
    height, width = wide.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, 1)
    return cv2.warpAffine(wide, turn, (width, height), borderMode=cv2.BORDER_REPLICATE)


def behind(person: Capture, other: Capture) -> np.ndarray:
    """The other person 60 % as high, farther back on the right."""
    used = rows(other)
    columns = np.flatnonzero(other.mask.any(axis=0))
    area = slice(used[0], used[1] + 1), slice(columns[0], columns[-1] + 1)
    theirs = small(other.mask[area].astype(np.uint8) * 255, 0.6) > 127
    low, high = rows(person)
    top, left = low + int(0.85 * (high - low)) - len(theirs), int(0.83 * 1024) - theirs.shape[1] // 2
    width = min(theirs.shape[1], 1024 - left)
    place = slice(top, top + len(theirs)), slice(left, left + width)
    out = person.picture.copy()
    shown = theirs[:, :width] & ~person.mask[place]
    out[place][shown] = small(other.picture[area], 0.6)[:, :width][shown]
    return out


def framed(picture: np.ndarray, factor: float, *borders: int) -> np.ndarray:
    """The picture made smaller, with more room around it: pixels above, below, left, right."""
    return cv2.copyMakeBorder(small(picture, factor), *borders, cv2.BORDER_REPLICATE)


GOOD: dict[str, tuple[str, Edit]] = {
    "as it is": ("front", lambda a, b: a.picture),
    "back": ("back", lambda a, b: a.seen(pelvis=(0, np.pi, 0))),
    "left": ("left", lambda a, b: a.seen(pelvis=(0, -np.pi / 2, 0))),
}

BAD: dict[str, tuple[str, Edit]] = {
    "an empty room": ("nobody", lambda a, b: a.room()),
    "nothing": ("nobody", lambda a, b: np.full((900, 700, 3), 128, np.uint8)),
    "two people": ("several", lambda a, b: np.hstack([a.picture, b.picture])),
    "somebody behind": ("several", behind),
    "no feet": ("cut_off", lambda a, b: a.picture[: rows(a)[1] - 40]),
    "no hand": ("cut_off", lambda a, b: a.picture[:, np.flatnonzero(a.mask.any(axis=0))[0] + 40 :]),
    "far away": ("small", lambda a, b: framed(a.picture, 0.2, 300, 200, 250, 250)),
    "on its side": ("lying", lambda a, b: np.ascontiguousarray(np.rot90(a.picture))),
    "half turned": ("turned", lambda a, b: a.seen(pelvis=(0, np.radians(40), 0))),
    "from behind": ("turned", lambda a, b: a.seen(pelvis=(0, np.pi, 0))),
    "arms down": ("arms", lambda a, b: a.seen(**arms(82))),
    "down to the thighs": ("cut_off", lambda a, b: a.picture[: level(a, "left_hip", "left_knee", 0.5)]),
    "three halves": ("several", lambda a, b: np.hstack([a.picture, b.picture, a.picture])[: level(a, "left_hip")]),
    "blurred": ("blurred", lambda a, b: cv2.GaussianBlur(a.picture, (0, 0), 3)),
    "shaken": ("blurred", lambda a, b: cv2.blur(a.picture, (17, 1))),
    "too bright": ("bright", lambda a, b: light(a.picture, 5)),
    "too dark": ("dark", lambda a, b: light(a.picture, 1 / 30)),
}

NOTES = ("no feet", "no hand", "half turned", "arms down")
"""Of BAD: what an avatar is made of all the same."""
TEXTS = {
    "down to the thighs": "the person is seen down to the thighs only; show them whole, shoes included",
    "from behind": "this shows the person's back, not the front; give the picture to its own option",
}
"""Of BAD: the first finding in full."""


@pytest.fixture
def pair() -> tuple[Capture, Capture]:
    needs_networks()
    return capture("p01"), capture("p02")


@pytest.mark.parametrize("name", GOOD)
def test_good_pictures_pass(pair, name: str) -> None:
    view, edit = GOOD[name]
    found = check_capture(edit(*pair), view)
    assert not found.findings and found.person is not None and found.mask.any(), found.findings


@pytest.mark.check
@pytest.mark.parametrize("name", BAD)
def test_faults_are_named(pair, name: str) -> None:
    code, edit = BAD[name]
    picture = np.ascontiguousarray(edit(*pair))
    found = check_capture(picture)
    assert code in [finding.code for finding in found.findings], found.findings
    assert found.findings and all("\n" not in finding.text for finding in found.findings)
    assert found.refused == (name not in NOTES), found.findings
    assert next(finding for finding in found.findings if finding.code == code).refusal == (name not in NOTES)
    assert found.findings[0].text == TEXTS.get(name, found.findings[0].text)
    if code == "nobody":
        assert found.person is None and found.mask.shape == picture.shape[:2] and not found.mask.any()


@pytest.mark.check
@pytest.mark.parametrize(
    ("turns", "words"),  # turns: of both shoulders, left and right, and of both elbows
    [
        (
            [(0.73, -1.16, -1.09), (0.26, 0.24, 1.4), (0, -0.89, 0), (0, 0.07, 0)],
            "the left hand is before the belly and the right arm hangs along the body",
        ),
        ([(0.26, -0.24, -1.4), (1.16, 0.5, 1.76), (0, -0.07, 0), (0, 0.45, 0)], "the right hand is hidden"),
    ],
)
def test_arms_are_named(pair, turns: list[tuple[float, float, float]], words: str) -> None:
    person, names = pair[0], pair[0].mesh.skeleton.names
    rotations = np.zeros_like(person.pose)
    rotations[[names.index(f"{side}_{joint}") for joint in ("shoulder", "elbow") for side in ("left", "right")]] = turns
    found = check_capture(person.shown(Pose(rotations, person.trans)))
    assert not found.refused and [finding.code for finding in found.findings] == ["arms"]
    assert words in found.findings[0].text


def real(shared_data: Path, name: str) -> np.ndarray:
    needs_networks()
    return read_photo(shared_data / "photos" / name, 1200).picture


@pytest.mark.check
@pytest.mark.shared
def test_people_whom_one_network_overlooks_are_several(shared_data: Path) -> None:
    """A grey person before shelves and a coloured one: a face beside somebody is somebody."""
    first, second = real(shared_data, "11.jpg"), real(shared_data, "14.jpg")
    height = min(len(first), len(second))
    both = [cv2.resize(each, (round(each.shape[1] * height / len(each)), height)) for each in (first, second)]
    found = check_capture(np.hstack(both))
    assert [finding.code for finding in found.findings if finding.refusal] == ["several"], found.findings


@pytest.mark.check
@pytest.mark.shared
def test_the_whole_picture_is_looked_at_before_nobody_is_there(shared_data: Path) -> None:
    """Mirrored, in a busy room: the first network leads the others to a piece of the room."""
    found = check_capture(np.ascontiguousarray(real(shared_data, "14.jpg")[:, ::-1]))
    assert not found.refused, found.findings


@pytest.mark.check
def test_half_of_somebody_is_not_told_to_come_closer(pair) -> None:
    """Seen down to the thighs from afar: whole people are to be shown, not nearer ones."""
    half = BAD["down to the thighs"][1](*pair)
    size = 360 / (half.shape[0] - rows(pair[0])[0])
    found = check_capture(small(np.ascontiguousarray(half), size))
    assert found.refused and found.mask.any(axis=1).sum() < 400
    assert [finding.code for finding in found.findings if finding.refusal] == ["cut_off"]


@pytest.mark.check
def test_a_frame_is_no_outline(pair) -> None:
    person = pair[0]
    found = check_capture(person.picture)
    assert found.person is not None and is_outline(found.person, person.mask)
    frame = np.zeros(person.mask.shape, bool)
    frame[20:-20, 20:-20] = True
    assert not is_outline(found.person, frame)


def test_blur_grows_with_blur() -> None:
    rng = np.random.default_rng(0)
    sharp = cv2.resize(rng.integers(0, 256, (60, 40, 3), np.uint8), (400, 600), interpolation=cv2.INTER_NEAREST)
    mask = np.ones((600, 400), bool)
    values = [blur_of(sharp, mask), *(blur_of(cv2.GaussianBlur(sharp, (0, 0), s), mask) for s in (1, 2, 4))]
    assert values == sorted(values) and values[0] < 0.3 and values[-1] > 0.6
    assert blur_of(cv2.blur(sharp, (15, 1)), mask) > 0.6  # one direction is enough
    assert blur_of(np.full_like(sharp, 9), mask) == 1.0 and blur_of(sharp, ~mask) == 1.0
