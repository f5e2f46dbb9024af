"""Checks of frames, and facing directions."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.errors import CaptureError, FormatError
from glsplat.extras.authoring.check.capture import Capture, Finding
from glsplat.extras.authoring.networks.people import degrees_between
from glsplat.extras.authoring.networks.person import LANDMARKS
from glsplat.extras.authoring.video import frames as module
from glsplat.extras.authoring.video.frames import check_frames, facings, frames_of
from tests.extras.authoring.video.test_film import picture, write

PICTURE = np.full((40, 30, 3), 90, np.uint8)
CUT = Finding("cut_off", "the feet reach out of the picture; leave room on all four sides")
NOBODY = Finding("nobody", "nobody is found in the picture; show one whole person, upright")


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Gives pictures in which people are found as they are told to be."""
    known: dict[int, Capture] = {}

    def check(rgb: np.ndarray, view: str | None) -> Capture:
        assert view is None
        return known[int(rgb[0, 0, 0])]

    monkeypatch.setattr(module, "check_capture", check)
    monkeypatch.setattr(module, "facing_as", lambda rgb, person, turn: person)

    def made(turns: Any, findings: dict[int, Finding] | None = None) -> list[Any]:
        out = []
        for number, turn in enumerate(turns):
            rgb = PICTURE.copy()
            rgb[0, 0] = number
            finding = (findings or {}).get(number)
            who = None if finding is not None and finding.code == "nobody" else person(float(turn))
            mask = np.ones((40, 30), bool)
            known[number] = Capture((finding,) if finding is not None else (), who, mask)
            out.append((f"{number}.jpg", rgb, None))
        return out

    return made


def test_the_front_comes_first_and_the_rest_in_order(seen: Any) -> None:
    frames, left_out = check_frames(seen(range(-160, 200, 30)), in_order=True)
    assert left_out == [] and len(frames) == 12
    turns = [frame.turn for frame in frames]
    assert abs((turns[0] + 180) % 360 - 180) < 12
    rest = np.diff(np.unwrap(np.radians(turns[1:])))
    assert (rest > 0).all()


def test_frames_without_a_person_are_reported(seen: Any) -> None:
    pictures = seen(np.arange(0, 360, 30), {2: NOBODY, 7: CUT})
    frames, left_out = check_frames(pictures, in_order=True)
    assert len(frames) == 10
    assert left_out == [f"2.jpg is left out: {NOBODY.text}", f"7.jpg is left out: {CUT.text}"]
    frames, left_out = check_frames(pictures, in_order=True, anyway=True)
    assert len(frames) == 11 and len(left_out) == 1


@pytest.mark.parametrize(
    ("turns", "message"),
    [
        (np.linspace(-4, 4, 10), r"the person turns by \d+ degrees only; let them turn on the spot once"),
        (np.linspace(0, 200, 10), r"no frame shows 1\d\d degrees of the turn"),
        (np.linspace(60, 300, 12), r"no frame shows 1\d\d degrees of the turn"),
        (np.linspace(50, 310, 12), r"no frame shows the front: the nearest is turned by \d+ degrees"),
    ],
)
def test_incomplete_turns_are_refused(seen: Any, turns: np.ndarray, message: str) -> None:
    with pytest.raises(CaptureError, match=message) as error:
        check_frames(seen(turns), in_order=True)
    assert "\n" not in str(error.value)
    assert check_frames(seen(turns), in_order=True, anyway=True)[0]


def test_pictures_and_videos_are_distinguished(tmp_path: Path) -> None:
    films = [write(tmp_path / "a.avi", [picture(number) for number in range(9)], "MJPG")]
    pictures, in_order = frames_of(films, 30)
    assert in_order and [name for name, *_ in pictures] == [f"frame {number}" for number in range(1, 10)]
    paths = [tmp_path / f"{number}.png" for number in range(8)]
    for path in paths:
        cv2.imwrite(str(path), PICTURE)
    pictures, in_order = frames_of(paths, 30)
    assert not in_order and [name for name, *_ in pictures] == [str(path) for path in paths]
    with pytest.raises(FormatError, match="one video alone, or pictures alone, not both"):
        frames_of([*paths, *films], 30)
    with pytest.raises(FormatError, match=r"0\.png: neither a video nor several pictures; give a video"):
        frames_of(paths[:1], 30)
    with pytest.raises(FormatError, match=r"0\.png: only 3 pictures; give a video"):
        frames_of(paths[:3], 30)
    with pytest.raises(FormatError, match="no frames"):
        frames_of([], 30)
    paths[4].write_text("no picture")
    with pytest.raises(FormatError, match=r"4\.png: "):
        frames_of(paths, 30)


def person(turn: float, face: float | None = None) -> Any:
    """Return the person that networks detect after a turn, degrees."""
    world = np.zeros((33, 3))
    for name, half in (("shoulder", 0.18), ("hip", 0.12)):
        across = half * np.array([np.cos(np.radians(turn)), 0.0, np.sin(np.radians(turn))])
        world[LANDMARKS.index(f"left_{name}")], world[LANDMARKS.index(f"right_{name}")] = across, -across
    presence = float(degrees_between(turn, 0) < 75) if face is None else face
    return SimpleNamespace(body=SimpleNamespace(world=world), face=SimpleNamespace(presence=presence))


def off(found: np.ndarray, turns: np.ndarray) -> np.ndarray:
    return np.abs((found - turns + 180) % 360 - 180)


@pytest.mark.parametrize("whole", [1.0, -1.0, 2.5, -0.6])
@pytest.mark.parametrize("start", [0.0, 140.0])
def test_noise_and_flips_are_corrected(rng: np.random.Generator, whole: float, start: float) -> None:
    turns = start + np.arange(30) * 360 * whole / 30 + rng.normal(0, 3, 30)
    measured = turns + rng.normal(0, 8, 30)
    people = [person(turn, float(degrees_between(true, 0) < 75)) for turn, true in zip(measured, turns, strict=True)]
    for index in (3, 12, 20):  # a back for a front
        people[index] = person(180 - measured[index], 0.5)
    people[8] = person(float(rng.uniform(0, 360)), 0.5)
    assert off(facings(people, in_order=True), turns).max() < 25


def test_hair_before_a_face() -> None:
    """No face is found in the front, which the body network takes for a back; neighbouring frames correct it."""
    turns = np.arange(-60, 61, 12.0)
    people = [person(180 - turn, 0.0) if abs(turn) < 20 else person(turn) for turn in turns]
    assert off(facings(people, in_order=True), turns).max() < 20


def test_pictures_in_no_order() -> None:
    turns = np.array([200.0, 10, 300, 95, 150, 40, 260, 330])
    found = facings([person(turn) for turn in turns], in_order=False)
    assert off(found, turns).max() < 5 and (found >= 0).all() and (found < 360).all()
    mirrored = person(180.0, 1.0)  # a face is seen: this is a front
    assert degrees_between(float(facings([mirrored], in_order=False)[0]), 0) < 10
