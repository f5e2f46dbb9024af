"""Sound to visemes to a mouth: streams, rates, loudness, silence, and what is no sound."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.speech.analysis import Analysis, table
from glsplat.extras.speech.sound import Sound, read_wav
from glsplat.extras.speech.speaking import Mouth, Speaking
from glsplat.skinning.expression import ARKIT
from tests.extras.speech.sounds import vowels

RATE = 16000
DATA = Path(__file__).parent / "data"


def mouth_of(sound, rate=RATE, piece=None):
    """[frames, weights] and the seconds they are about."""
    analysis, mouth, out = Analysis(rate), Mouth(), []
    piece = piece or len(sound)
    for first in range(0, len(sound), piece):
        out += [(t, *mouth.add(v, level).values()) for t, v, level in analysis.add(sound[first : first + piece])]
    return np.array(out)[:, 1:], np.array(out)[:, 0]


def test_the_table_mixes_shapes_of_arkit():
    t = table()
    assert len(t.visemes) >= 6 and not t.visemes["sil"] and "jawOpen" not in t.visemes[t.closes]
    weights = [pair for mixed in t.visemes.values() for pair in mixed.items()]
    assert all(name in ARKIT and 0 < weight <= 1 for name, weight in weights)


def test_pieces_make_no_difference():
    sound = vowels(1, RATE)
    whole, times = mouth_of(sound)
    for piece in (1, 128, 777):
        found, seconds = mouth_of(sound[: RATE // 4] if piece == 1 else sound, piece=piece)
        assert np.array_equal(found, whole[: len(found)]) and np.array_equal(seconds, times[: len(found)])
    assert np.allclose(np.diff(times), table().framing.hop)


def test_vowels_open_the_mouth_and_silence_closes_it():
    names = sorted({name for weights in table().visemes.values() for name in weights})
    jaw = names.index("jawOpen")
    sound = np.concatenate([vowels(1.5, RATE, each=0.5), np.zeros(RATE)])
    found, times = mouth_of(sound)
    aa, i = (found[(times > a + 0.15) & (times < a + 0.45)].mean(axis=0) for a in (0, 0.5))
    assert aa[jaw] > 1.5 * i[jaw] > 0.05
    assert found[times > 1.8].max() < 0.02
    assert found.min() >= 0 and found.max() <= 1


def test_lips_close_where_a_voice_needs_them_closed():
    """A sentence with its maker's own times."""
    told = json.loads((DATA / "balloon.json").read_text(encoding="utf-8"))
    speaking = Speaking(read_wav(DATA / "balloon.wav"))
    times = np.arange(0, told["phonemes"][-1][2], 0.01)
    jaw = np.array([speaking.at(t)["jawOpen"] for t in times])
    press = np.array([speaking.at(t)["mouthPressLeft"] for t in times])
    lips = [(begin, end) for name, begin, end in told["phonemes"] if name in "mbp"]
    assert len(lips) == 10
    closed = [bool((jaw[(times > a - 0.02) & (times < b + 0.02)] < 0.02).any()) for a, b in lips]
    pressed = [bool((press[(times > a - 0.02) & (times < b + 0.02)] > 0.3).any()) for a, b in lips]
    assert sum(closed) >= 9 and sum(pressed) >= 9
    vowels = [(a, b) for name, a, b in told["phonemes"] if name in ("a", "eI", "V", "aI", "u:")]
    open_ = [jaw[(times > a) & (times < b)].max() for a, b in vowels]
    assert min(open_) > 0.05 and max(open_) > 0.25


def test_the_jaw_goes_by_loudness():
    vowel = np.array([name == "aa" for name in table().visemes], float)

    def jaw(level):
        mouth = Mouth()
        return [mouth.add(vowel, level)["jawOpen"] for _ in range(50)][-1]

    least, silence = table().jaw
    found = [jaw(-decibels) for decibels in (0, 10, 20, silence, 90)]
    assert found[0] == pytest.approx(table().visemes["aa"]["jawOpen"], rel=1e-6)
    assert found[0] > 1.2 * found[1] > 1.4 * found[2] and found[3] == found[4] == pytest.approx(least * found[0])


def test_before_and_after_a_sound_the_mouth_is_at_rest():
    speaking = Speaking(Sound(vowels(0.5, RATE).astype(np.float32), RATE))
    assert speaking.at(-1) == speaking.at(-0.5)
    assert max(speaking.at(5).values()) < 0.02 and max(speaking.at(0.3).values()) > 0.1


def test_rate_and_loudness_make_little_difference():
    one, other = (mouth_of(vowels(1, rate), rate)[0] for rate in (16000, 48000))
    assert np.abs(one - other).mean() < 0.02
    sound = np.concatenate([vowels(3, RATE)] * 2)
    one, other = (mouth_of(sound * gain)[0][450:] for gain in (1.0, 0.1))
    assert np.abs(one - other).max() < 1e-3


def test_hard_sound_gives_weights():
    for value, count in ((0, 4000), (np.nan, 4000), (np.inf, 4000), (1e30, 4000), (1, 4000), (0, 0)):
        mouth = Mouth()
        for _, visemes, level in Analysis(RATE).add(np.full(count, float(value))):
            assert np.isfinite(visemes).all() and visemes.sum() == pytest.approx(1) and -120 <= level <= 1e-3
            assert all(0 <= weight <= 1 for weight in mouth.add(visemes, level).values())
    for rate in (0, 15999, 1e6, float("nan")):
        with pytest.raises(FormatError, match="samples a second"):
            Analysis(rate)
