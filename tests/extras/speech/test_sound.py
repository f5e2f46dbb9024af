"""Sound files: formats of .wav, damaged ones, and FLAC in MP4 to the bit."""

from __future__ import annotations

import os
import random
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.speech.mp4 import add_sound
from glsplat.extras.speech.sound import Sound, read_wav
from tests.extras.speech.sounds import vowels, wav_bytes

BLOCK = 4096  # samples of a frame of FLAC
RAMP = np.linspace(-1, 1, 600)


def wav(kind, bits, data, channels=1, rate=16000, form=b"", before=b""):
    head = struct.pack("<HHIIHH", kind, channels, rate, rate * channels * bits // 8, channels * bits // 8, bits) + form
    chunks = before + b"fmt " + struct.pack("<I", len(head)) + head + b"data" + struct.pack("<I", len(data)) + data
    return b"RIFF" + struct.pack("<I", 4 + len(chunks)) + b"WAVE" + chunks


def read(data, tmp_path):
    (tmp_path / "a.wav").write_bytes(data)
    return read_wav(tmp_path / "a.wav")


def packed24(values):
    return np.rint(values * (2**23 - 1)).astype("<i4").view(np.uint8).reshape(-1, 4)[:, :3].tobytes()


FORMATS = [  # kind, bits, data, largest error
    (1, 8, np.rint(RAMP * 127 + 128).astype(np.uint8).tobytes(), 1 / 64),
    (1, 16, np.rint(RAMP * 32767).astype("<i2").tobytes(), 1e-4),
    (1, 24, packed24(RAMP), 1e-6),
    (1, 32, np.rint(RAMP * (2**31 - 1)).astype("<i4").tobytes(), 1e-6),
    (3, 32, RAMP.astype("<f4").tobytes(), 1e-6),
    (3, 64, RAMP.astype("<f8").tobytes(), 1e-6),
    (0xFFFE, 16, np.rint(RAMP * 32767).astype("<i2").tobytes(), 1e-4),
]


def test_formats(tmp_path):
    for kind, bits, data, off in FORMATS:
        form = struct.pack("<HHI", 22, bits, 4) + b"\1\0" + bytes(14) if kind == 0xFFFE else b""
        sound = read(wav(kind, bits, data, form=form, before=b"LIST" + struct.pack("<I", 3) + b"abc\0"), tmp_path)
        assert sound.rate == 16000 and len(sound.samples) == len(RAMP)
        assert np.abs(sound.samples - RAMP).max() <= off, (kind, bits)


def test_channels_are_averaged_and_a_stream_has_what_it_has(tmp_path):
    both = np.stack([RAMP, -RAMP + 0.5], 1)
    data = wav(1, 16, np.rint(both * 16000).astype("<i2").tobytes(), channels=2)
    sound = read(data, tmp_path)
    assert np.abs(sound.samples - 0.25 * 16000 / 32768).max() < 1e-3
    at = data.index(b"data") + 4
    cut = data[:at] + b"\xff\xff\xff\xff" + data[at + 4 : -6]  # as a pipe writes it, and cut within a sample
    assert len(read(cut, tmp_path).samples) == len(RAMP) - 2


def test_what_is_no_sound_is_one_line(tmp_path):
    wrong = [
        b"",
        b"RIFF",
        b"RIFF\0\0\0\0WAVE",
        b"RIFF\0\0\0\0WAVEdata\4\0\0\0abcd",
        b"OggS" + bytes(40),
        wav(1, 16, b""),
    ]
    wrong += [wav(6, 8, b"abcd"), wav(1, 12, b"abcd"), wav(1, 16, b"ab", channels=0), wav(1, 16, b"ab", rate=0)]
    wrong += [
        wav(1, 16, b""),
        wav(1, 16, bytes(64), rate=10**9),
        wav(1, 16, bytes(80), rate=1)[:30],
        wav(1, 8, bytes(4000), rate=1),
    ]
    for data in wrong:
        with pytest.raises(FormatError, match=r"a\.wav: [^\n]+$"):
            read(data, tmp_path)
    os.mkfifo(tmp_path / "pipe.wav")
    for name in ("none.wav", ".", "pipe.wav"):
        with pytest.raises(FormatError):
            read_wav(tmp_path / name)


def test_damaged_files_are_read_or_refused(tmp_path):
    chance = random.Random(5)
    good = wav_bytes(Sound(RAMP.astype(np.float32), 16000))
    for _ in range(200):
        data = bytearray(good[: chance.choice([len(good), chance.randrange(len(good))])])
        for _ in range(chance.randrange(4)):
            if data:
                data[chance.randrange(min(len(data), 60))] = chance.randrange(256)
        try:
            sound = read(bytes(data), tmp_path)
        except FormatError:
            continue
        assert np.isfinite(sound.samples).all() and len(sound.samples) <= len(data)


def clip(path: Path, seconds: float) -> None:
    cv2 = pytest.importorskip("cv2")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), 20.0, (64, 48))
    for i in range(int(20 * seconds)):
        writer.write(np.full((48, 64, 3), (i * 7) % 255, np.uint8))
    writer.release()


def pictures(path: Path) -> list[tuple[Fraction, bytes]]:
    """Return time in seconds and encoded bytes of each picture."""
    av = pytest.importorskip("av")
    with av.open(str(path)) as file:
        return [(p.pts * p.time_base, bytes(p)) for p in file.demux(video=0) if p.pts is not None]


def decoded(path: Path) -> tuple[np.ndarray, int]:
    """Return the samples of the sound and their rate."""
    av = pytest.importorskip("av")
    with av.open(str(path)) as file:
        sound = np.concatenate([frame.to_ndarray().ravel() for frame in file.decode(audio=0)])
        return sound, file.streams.audio[0].rate


def test_a_clip_has_the_sound_to_the_bit(tmp_path):
    speech, noise = vowels(1.3, 22050), np.random.default_rng(1).uniform(-1, 1, BLOCK + 1)
    quiet = np.random.default_rng(2).uniform(-0.01, 0.01, 130 * BLOCK)  # frames beyond 127 have longer numbers
    hard = (np.zeros(2 * BLOCK), np.tile([1.0, -1.0], 3000), np.array([0.5]), np.array([0.5, -0.5]))
    for number, samples in enumerate((speech, noise, quiet, *hard)):
        for rate in (22050, 16001, 384000) if number == 1 else (22050,):
            path = tmp_path / f"{number}.mp4"
            clip(path, 0.5)
            before = pictures(path)
            add_sound(path, Sound(samples.astype(np.float32), rate))
            assert len(before) == 10 and pictures(path) == before  # nothing is encoded anew
            whole = np.rint(samples.astype(np.float32).astype(float) * 32767).astype(np.int16)
            sound, found = decoded(path)
            assert found == rate and np.array_equal(sound, whole)
    clip(path, 0.5)
    silent = path.stat().st_size
    add_sound(path, Sound(vowels(2, 48000).astype(np.float32), 48000))
    assert path.stat().st_size - silent < 0.75 * 2 * 2 * 48000


def test_what_is_no_clip_is_refused_and_stays_as_it_was(tmp_path):
    path = tmp_path / "a.mp4"
    for data in (b"", b"\0\0\0\x08moov", b"\0\0\0\x04ftyp", b"\0\0\0\x10moovabcdefgh", bytes(40)):
        path.write_bytes(data)
        with pytest.raises(FormatError):
            add_sound(path, Sound(np.zeros(100, np.float32), 16000))
        assert path.read_bytes() == data and list(tmp_path.iterdir()) == [path]
