"""Video files are read regardless of wrong headers; other files are refused in one line."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.authoring.video import film
from glsplat.extras.authoring.video.film import is_video, read_frames

SIZE = 96, 64  # width, height


def picture(number: int, *, blurred: bool = False) -> np.ndarray:
    """Return a chequered frame with its number in the upper left corner."""
    tiles = np.indices(SIZE[::-1]) // 4
    frame = np.repeat((tiles.sum(axis=0) % 2 * 200 + 20)[..., None], 3, axis=2).astype(np.uint8)
    if blurred:
        frame = cv2.GaussianBlur(frame, (0, 0), 6)
    frame[:16, :16] = 4 * number
    return frame


def write(path: Path, frames: list[np.ndarray], code: str = "mp4v") -> Path:
    size = frames[0].shape[1::-1]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*code), 10, size)
    assert writer.isOpened()
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def numbers(frames: list[np.ndarray]) -> list[int]:
    return [round(float(frame[4:12, 4:12].mean()) / 4) for frame in frames]


@pytest.mark.parametrize(("name", "code"), [("a.mp4", "mp4v"), ("a.webm", "VP80")])
def test_frames_are_spread_evenly(tmp_path: Path, name: str, code: str) -> None:
    path = write(tmp_path / name, [picture(number) for number in range(60)], code)
    assert is_video(path)
    frames = read_frames(path, 10)
    assert len(frames) == 10 and all(frame.shape == (64, 96, 3) and frame.dtype == np.uint8 for frame in frames)
    found = numbers(frames)
    assert all(6 * index - 1 <= number <= 6 * index + 6 for index, number in enumerate(found)), found


def test_the_sharpest_of_an_interval_is_chosen(tmp_path: Path) -> None:
    sharp = {3, 14, 26, 36, 43, 56, 66, 73}
    frames = [picture(number % 60, blurred=number not in sharp) for number in range(80)]
    path = write(tmp_path / "a.avi", frames, "MJPG")
    assert numbers(read_frames(path, 8)) == [3, 14, 26, 36, 43, 56, 6, 13]


def test_upright_phone_videos_are_rotated(tmp_path: Path) -> None:
    """The matrix in the track's header turns the picture by a quarter."""
    path = write(tmp_path / "a.mp4", [picture(number) for number in range(12)])
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40  # version 0
    one = 1 << 16
    data[at : at + 36] = struct.pack(">9i", 0, one, 0, -one, 0, 0, 64 * one, 0, 1 << 30)
    path.write_bytes(data)
    frames = read_frames(path, 8)
    assert {frame.shape for frame in frames} == {(96, 64, 3)}
    assert frames[0][:16, -16:].mean() < 20 < frames[0][:16, :16].mean()  # the dark corner is on the right now


@pytest.mark.parametrize("told", [0, 9, 3_000, 2**31 - 1])
def test_a_header_with_a_wrong_number_of_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told: int) -> None:
    path = write(tmp_path / "a.avi", [picture(number) for number in range(40)], "MJPG")

    class Lying:
        def __init__(self, *words: object) -> None:
            self.film = opened(*words)

        def __getattr__(self, name: str) -> object:
            return getattr(self.film, name)

        def get(self, what: int) -> float:
            return float(told) if what == cv2.CAP_PROP_FRAME_COUNT else self.film.get(what)

    opened = cv2.VideoCapture
    monkeypatch.setattr(film.cv2, "VideoCapture", Lying)
    found = numbers(read_frames(path, 8))
    assert len(found) == 8 and (found[-1] >= 34 or told == 9)


TEXT = b"not a video at all\n" * 20
PLAYLIST = b"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nfile:///etc/passwd\n"
CONCAT = b"ffconcat version 1.0\nfile /etc/hostname\n"
HUGE = struct.pack(">I4sQ", 1, b"ftyp", 1 << 33) + b"isom" * 8  # eight gigabytes, says the first box


@pytest.mark.parametrize(
    "data", [b"", TEXT, PLAYLIST, CONCAT, b"\x89PNG\r\n\x1a\n" + b"\0" * 64, b"RIFF\0\0\0\0WAVEfmt "]
)
def test_files_that_are_not_videos(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=r"a\.mp4: not a video; give an \.mp4") as error:
        read_frames(path, 8)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("data", [HUGE, b"\0\0\0\x18ftypisom" + b"\0" * 400, b"\x1aE\xdf\xa3" + b"\xff" * 400])
def test_a_header_without_frames(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=r"a\.mp4: the video is damaged or of an unknown kind"):
        read_frames(path, 8)


def test_a_truncated_video(tmp_path: Path) -> None:
    path = write(tmp_path / "a.avi", [picture(number) for number in range(40)], "MJPG")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert 8 <= len(read_frames(path, 8))
    path.write_bytes(data[:6000])
    with pytest.raises(FormatError, match=r"a\.avi: "):
        read_frames(path, 8)


def test_too_short_too_large_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.avi", [picture(0), picture(1)], "MJPG")
    with pytest.raises(FormatError, match=r"a\.avi: a video needs at least 8 frames, this has 2; film a whole turn"):
        read_frames(path, 8)
    monkeypatch.setattr(film, "_MAX_BYTES", 10)
    with pytest.raises(FormatError, match="at most 0 GB"):
        read_frames(path, 8)
    with pytest.raises(FormatError, match=r"b\.mp4: .*No such file"):
        read_frames(tmp_path / "b.mp4", 8)
    with pytest.raises(FormatError):
        read_frames(tmp_path, 8)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mp4")
    with pytest.raises(FormatError):
        read_frames(tmp_path / "a.mp4", 8)


def test_large_frames_are_resized(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "MAX_SIDE_PX", 48)
    path = write(tmp_path / "a.avi", [picture(number) for number in range(9)], "MJPG")
    assert {frame.shape for frame in read_frames(path, 9)} == {(32, 48, 3)}
