"""Which frames are kept, and what is said of the others and of those who do not turn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.authoring.photo.capture import Capture, Finding
from glsplat.authoring.video import frames as module
from glsplat.authoring.video.frames import check_frames, frames_of
from glsplat.errors import CaptureError, FormatError
from tests.authoring.video.test_film import picture, write
from tests.authoring.video.test_turns import person

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


def test_frames_without_a_person_are_left_out_and_said(seen: Any) -> None:
    pictures = seen(np.arange(0, 360, 30), {2: NOBODY, 7: CUT})
    frames, left_out = check_frames(pictures, in_order=True)
    assert len(frames) == 10
    assert left_out == [f"2.jpg is left out: {NOBODY.text}", f"7.jpg is left out: {CUT.text}"]
    frames, left_out = check_frames(pictures, in_order=True, anyway=True)
    assert len(frames) == 11 and len(left_out) == 1


def test_a_room_without_a_person(seen: Any) -> None:
    pictures = seen(np.arange(0, 360, 30), dict.fromkeys(range(12), NOBODY))
    for anyway in (False, True):
        with pytest.raises(CaptureError, match=r"0 of 12 frames will do, 8 are needed; 0\.jpg is left out: nobody is"):
            check_frames(pictures, in_order=True, anyway=anyway)


@pytest.mark.parametrize(
    ("turns", "said"),
    [
        (np.linspace(-4, 4, 10), r"the person turns by \d+ degrees only; let them turn on the spot once"),
        (np.linspace(0, 200, 10), r"no frame shows 1\d\d degrees of the turn"),
        (np.linspace(60, 300, 12), r"no frame shows 1\d\d degrees of the turn"),
        (np.linspace(50, 310, 12), r"no frame shows the front: the nearest is turned by \d+ degrees"),
    ],
)
def test_who_does_not_turn_all_around(seen: Any, turns: np.ndarray, said: str) -> None:
    with pytest.raises(CaptureError, match=said) as error:
        check_frames(seen(turns), in_order=True)
    assert "\n" not in str(error.value)
    assert check_frames(seen(turns), in_order=True, anyway=True)[0]


def test_pictures_and_videos_are_told_apart(tmp_path: Path) -> None:
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
