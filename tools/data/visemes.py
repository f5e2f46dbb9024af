"""Make visemes.json of extras/speech: shapes chosen by hand, and a network that is trained to recognise them.

    python -m tools.data.visemes            # ten minutes; needs espeak-ng and flite

Synthetic voices with known times of phonemes speak tools/data/spoken.txt, with simulated microphones and noise:
espeak-ng by its library, flite by its program. Both are system packages (Debian: espeak-ng, flite); neither glsplat nor
a test needs them.
"""

from __future__ import annotations

import ctypes
import json
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from apps.progress import each
from glsplat.arrays import F32
from glsplat.extras.speech.analysis import Cepstra, Framing
from glsplat.extras.speech.sound import Sound, read_wav

FRAMING = Framing(
    hop=0.01, window=0.025, bands=24, low=80.0, high=7200.0, coefficients=13, tiny=1e-6,
    start=1e-3, least=1e-4, half_life=2.0,
)  # fmt: skip
AHEAD = 1  # frames
OFFSETS = tuple(offset - AHEAD for offset in (-8, -6, -4, -3, -2, -1, 0, 1))
HIDDEN, EPOCHS, BATCH, STEP = 40, 7, 2048, 4e-3
CLOSES = 1.6  # weight in the loss of frames with closed lips (PP)

ESPEAK: tuple[str, ...] = (
    "en",
    "en-us",
    "en-gb-scotland",
    "en-029",
    "en+m1",
    "en-us+m3",
    "en+m7",
    "en+f1",
    "en-us+f2",
    "en+f4",
)
ESPEAK += ("en-us+klatt2", "en+Andy", "en-us+Annie", "en+linda")
FLITE = ("slt", "rms", "kal16")  # awb is held out for measurements

# visemes of Meta's (Oculus) lip sync, nn among DD: https://developers.meta.com/horizon/documentation/unity/
# audio-ovrlipsync-viseme-reference
MOUTH = {"closes": "PP", "closed": [0.15, 0.45], "opens": 0.06, "smooth": 0.02, "least": 0.01, "jaw": [0.35, 30]}
VISEMES: dict[str, dict[str, float]] = {
    "sil": {},
    "PP": {"mouthPress": 0.35, "mouthRollLower": 0.3, "mouthRollUpper": 0.15},
    "FF": {"jawOpen": 0.05, "mouthRollLower": 0.55, "mouthUpperUp": 0.25, "mouthShrugLower": 0.2},
    "TH": {"jawOpen": 0.16, "mouthLowerDown": 0.15, "mouthUpperUp": 0.1, "tongueOut": 0.2},
    "DD": {"jawOpen": 0.12, "mouthLowerDown": 0.2, "mouthUpperUp": 0.1},
    "kk": {"jawOpen": 0.18, "mouthLowerDown": 0.15},
    "CH": {"jawOpen": 0.1, "mouthFunnel": 0.55, "mouthPucker": 0.15},
    "SS": {"jawOpen": 0.04, "mouthStretch": 0.3, "mouthLowerDown": 0.3, "mouthUpperUp": 0.1},
    "RR": {"jawOpen": 0.14, "mouthFunnel": 0.35, "mouthPucker": 0.2},
    "aa": {"jawOpen": 0.5, "mouthLowerDown": 0.15, "mouthUpperUp": 0.1},
    "E": {"jawOpen": 0.3, "mouthStretch": 0.2, "mouthLowerDown": 0.2, "mouthUpperUp": 0.1},
    "I": {"jawOpen": 0.17, "mouthSmile": 0.15, "mouthStretch": 0.3, "mouthLowerDown": 0.2},
    "O": {"jawOpen": 0.38, "mouthFunnel": 0.5, "mouthPucker": 0.15},
    "U": {"jawOpen": 0.16, "mouthPucker": 0.6, "mouthFunnel": 0.2},
}
SIDED = ("mouthPress", "mouthUpperUp", "mouthLowerDown", "mouthStretch", "mouthSmile")

# phonemes of espeak-ng (its English), then of flite (ARPAbet); _TWO has those of two visemes in turn
_SOUNDS = {
    "sil": "_ _: pau", "PP": "m b p", "FF": "f v", "TH": "T D th dh", "DD": "t d n l t2 @L l# n- t#",
    "kk": "k g N h ng hh", "CH": "S Z tS dZ sh zh ch jh", "SS": "s z", "RR": "r er axr 3:",
    "aa": "a aa A A: A@ V a# a2 ae ah ay aw", "I": "I i i: I2 j ; iy ih y",
    "E": "E e @ @2 3 @- I# ax eh", "O": "0 O O: O@ o o: ao ow oy", "U": "U u u: w uw uh",
}  # fmt: skip
_TWO = {"aI": "aa I", "aI@": "aa I", "aI3": "aa I", "ay": "aa I", "eI": "E I", "ey": "E I", "OI": "O I", "oy": "O I"}
_TWO |= {"aU": "aa U", "aU@": "aa U", "aw": "aa U", "oU": "O U", "@U": "E U", "ow": "O U", "i@": "I E", "e@": "E E"}
_TWO |= {"U@": "U E", "i@3": "I E", "e@3": "E E", "ju:": "I U"}
VISEME_OF = {name: (viseme,) for viseme, names in _SOUNDS.items() for name in names.split()} | {
    name: tuple(two.split()) for name, two in _TWO.items()
}


@dataclass(frozen=True)
class Said:
    """A sentence: its sound, and (phoneme, begin, end) in seconds."""

    sound: Sound
    phonemes: list[tuple[str, float, float]]


class _Id(ctypes.Union):
    _fields_: ClassVar = [("number", ctypes.c_int), ("name", ctypes.c_char_p), ("string", ctypes.c_char * 8)]


class _Event(ctypes.Structure):  # espeak_EVENT of speak_lib.h
    _fields_: ClassVar = [
        *((name, ctypes.c_int) for name in ("type", "unique_identifier", "text_position", "length")),
        *((name, ctypes.c_int) for name in ("audio_position", "sample")),
        *(("user_data", ctypes.c_void_p), ("id", _Id)),
    ]


_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event))
_PHONEME = 7
_heard: list[NDArray[np.int16]] = []
_begins: list[tuple[str, float]] = []


def _listen(samples: Any, count: int, events: Any) -> int:
    if samples and count > 0:
        _heard.append(np.ctypeslib.as_array(samples, (count,)).copy())
    i = 0
    while events[i].type:
        if events[i].type == _PHONEME:
            _begins.append((events[i].id.string.decode("utf8", "replace"), events[i].audio_position / 1e3))
        i += 1
    return 0


_callback = _CALLBACK(_listen)


@cache
def _library() -> tuple[Any, int]:
    library = ctypes.CDLL("libespeak-ng.so.1")
    rate = library.espeak_Initialize(2, 0, None, 1)  # synchronous, with events of phonemes
    library.espeak_SetSynthCallback(_callback)
    return library, rate


def espeak(text: str, voice: str, words: int, pitch: int) -> Said:
    """Speak a text by espeak-ng, at ``words`` per minute. Raises ValueError for an unknown voice."""
    library, rate = _library()
    _heard.clear()
    _begins.clear()
    if library.espeak_SetVoiceByName(voice.encode()):
        raise ValueError(f"espeak-ng has no voice {voice}")
    library.espeak_SetParameter(1, words, 0)
    library.espeak_SetParameter(3, pitch, 0)
    data = text.encode()
    library.espeak_Synth(ctypes.c_char_p(data), ctypes.c_size_t(len(data) + 1), 0, 0, 0, 1, None, None)
    library.espeak_Synchronize()
    sound = Sound((np.concatenate(_heard) / 32768).astype(np.float32), rate)
    ends = [begin for _, begin in _begins[1:]] + [sound.seconds]
    return Said(sound, [(name, begin, end) for (name, begin), end in zip(_begins, ends, strict=True)])


def flite(text: str, voice: str) -> Said:
    """Speak a text by flite, with a voice made of recordings of a person: slt, rms, awb, kal16."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "said.wav"
        command = ["flite", "-voice", voice, "-psdur", "-t", text, "-o", str(path)]
        out = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        sound = read_wav(path)
    phonemes, begin = [], 0.0
    for word in out:
        name, _, end = word.rpartition(":")
        phonemes.append((name, begin, float(end)))
        begin = float(end)
    return Said(sound, phonemes)


def visemes_of(phoneme: str) -> tuple[str, ...]:
    """Return the visemes of a phoneme, with or without marks of espeak-ng."""
    bare = phoneme.strip("'-,%=!?")
    found = VISEME_OF.get(bare) or VISEME_OF.get(bare.rstrip("#23:")) or VISEME_OF.get(bare.rstrip("#235:@"))
    return found or ("sil" if phoneme.startswith("_") else "E",)


def labels(said: Said, frames: int) -> NDArray[np.int64]:
    """Return the true viseme, by number, of each frame of ``Cepstra``, [frames]."""
    names, out = list(VISEMES), np.zeros(frames, np.int64)
    times = (np.arange(frames) - AHEAD) * FRAMING.hop - FRAMING.window / 2
    for phoneme, begin, end in said.phonemes:
        parts = visemes_of(phoneme)
        for i, viseme in enumerate(parts):
            first, last = (begin + (end - begin) * k / len(parts) for k in (i, i + 1))
            out[(times >= first) & (times < last)] = names.index(viseme)
    return out


def heard(said: Said, rng: np.random.Generator) -> tuple[F32, NDArray[np.int64]]:
    """Return inputs [N, offsets * coefficients] and labels [N] of a sentence with a random microphone and noise."""
    sound, rate = said.sound.samples.astype(np.float64), said.sound.rate
    if rng.random() < 0.7:
        sound = np.convolve(sound, [1, -rng.uniform(-0.5, 0.75)])[: len(sound)]
        noise = rng.standard_normal(len(sound))
        if rng.random() < 0.5:
            noise = np.convolve(noise, np.ones(12) / 12, "same")
        noise *= np.sqrt(np.square(sound).mean() / np.square(noise).mean()) * 10 ** (-rng.uniform(15, 60) / 20)
        sound = (sound + noise) * 10 ** rng.uniform(-1.3, -0.1) / np.abs(sound).max()
    cepstra = np.array([cepstrum for cepstrum, _ in Cepstra(FRAMING, rate).add(sound)])
    before = np.concatenate([np.repeat(cepstra[:1], -min(OFFSETS), 0), cepstra])
    rows = [before[-min(OFFSETS) + offset : len(before) + offset] for offset in OFFSETS]
    return np.concatenate(rows, 1).astype(np.float32), labels(said, len(cepstra))


def examples(rng: np.random.Generator) -> tuple[F32, NDArray[np.int64]]:
    """Return all training inputs and labels."""
    found = []
    for text in each(Path(__file__).with_name("spoken.txt").read_text("utf-8").splitlines(), "sentences"):
        for voice in ESPEAK:
            found.append(heard(espeak(text, voice, int(rng.integers(120, 210)), int(rng.integers(35, 70))), rng))
        found += [heard(flite(text, voice), rng) for voice in FLITE for _ in range(3)]
    return np.concatenate([x for x, _ in found]), np.concatenate([y for _, y in found])


def learned(x: F32, y: NDArray[np.int64], rng: np.random.Generator) -> list[F32]:
    """Return weights and biases of both layers, trained by cross entropy and Adam (Kingma & Ba 2015), cosine decay."""
    mean, spread = x.mean(0), x.std(0) + 1e-3
    x = (x - mean) / spread
    sizes = (x.shape[1], HIDDEN, len(VISEMES))
    weights = [rng.standard_normal((a, b)).astype(np.float32) * a**-0.5 for a, b in pairwise(sizes)]
    net = [weights[0], np.zeros(HIDDEN, np.float32), weights[1], np.zeros(len(VISEMES), np.float32)]
    first, second = ([np.zeros_like(one) for one in net] for _ in range(2))
    cost = np.where(np.arange(len(VISEMES)) == list(VISEMES).index("PP"), CLOSES, 1.0).astype(np.float32)
    steps = EPOCHS * (len(x) // BATCH)
    order, right = rng.permutation(len(x)), 0.0
    for step in each(range(1, steps + 1), "steps"):
        if len(order) < BATCH:
            order = rng.permutation(len(x))
        rows, order = order[:BATCH], order[BATCH:]
        hidden = np.tanh(x[rows] @ net[0] + net[1])
        logits = hidden @ net[2] + net[3]
        likely = np.exp(logits - logits.max(1, keepdims=True))
        likely /= likely.sum(1, keepdims=True)
        right += 0.01 * (float((likely.argmax(1) == y[rows]).mean()) - right)
        off = likely
        off[np.arange(BATCH), y[rows]] -= 1
        off *= cost[y[rows], None] / BATCH
        inner = (off @ net[2].T) * (1 - hidden**2)
        slopes = [x[rows].T @ inner, inner.sum(0), hidden.T @ off, off.sum(0)]
        rate = STEP * 0.5 * (1 + np.cos(np.pi * step / steps))
        for one, slope, m, v in zip(net, slopes, first, second, strict=True):
            m += 0.1 * (slope - m)
            v += 0.001 * (slope**2 - v)
            one -= rate * (m / (1 - 0.9**step)) / (np.sqrt(v / (1 - 0.999**step)) + 1e-8)
        if step % 50 == 0:
            print(f"step {step}: {right:.3f} right")
    net[1] = net[1] - (mean / spread) @ net[0]
    net[0] = net[0] / spread[:, None]
    return net


def table_of(net: list[F32]) -> dict[str, Any]:
    """Return the content of visemes.json."""

    def rounded(array: NDArray[Any]) -> list[Any]:
        return [rounded(row) for row in array] if array.ndim > 1 else [float(f"{value:.4g}") for value in array]

    names = ("hidden", "hidden_bias", "output", "output_bias")
    sides = {name: [f"{name}Left", f"{name}Right"] if name in SIDED else [name] for v in VISEMES.values() for name in v}
    return {
        "sound": {name: getattr(FRAMING, name) for name in Framing.__dataclass_fields__},
        "network": {"ahead": AHEAD, "offsets": OFFSETS} | dict(zip(names, map(rounded, net), strict=True)),
        "visemes": {v: {side: w for name, w in one.items() for side in sides[name]} for v, one in VISEMES.items()},
        "mouth": MOUTH,
    }


if __name__ == "__main__":
    generator = np.random.default_rng(36)
    made = table_of(learned(*examples(generator), generator))
    with resources.as_file(resources.files("glsplat.extras.speech") / "web" / "voice" / "visemes.json") as path:
        Path(path).write_text(json.dumps(made, separators=(",", ":")) + "\n", encoding="utf-8")
