"""How often the mouth is closed where lips have to be, by the phonemes' own times.

    python -m tools.data.closures ict_face.npz            # ICT-FaceKit (light), packed; needs espeak-ng and flite

Between the lips of ICT-FaceKit's head, whose shapes are ARKit's: closed is up to half a millimetre more than at rest.
A phoneme counts as closed if the lips are at any frame within 20 ms of it; of all others it is counted how many have
closed lips from begin to end.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.speech.speaking import Speaking
from glsplat.skinning.expression import arkit_name
from tools.data.spoken import DEVELOPED, SET_ASIDE
from tools.data.visemes import visemes_of
from tools.data.voices import Said, espeak, flite

AROUND = 0.02  # seconds
SLACK = 0.5e-3  # metres
UPPER, LOWER = (61, 62, 63), (67, 66, 65)  # of Multi-PIE's landmarks: the inner rims


def gap_of(path: Path) -> Callable[[Mapping[str, float]], float]:
    """Metres that an expression opens the lips beyond what they are at rest."""
    with np.load(path) as data:
        upper, lower = (data["landmarks68"][list(rim)] for rim in (UPPER, LOWER))
        moves = data["expression_delta"][:, :, 1] * data["expression_scale"][:, None].astype(np.float64)
        names = [arkit_name(str(name)) for name in data["expression_names"]]
    opens = {name: moves[i, upper] - moves[i, lower] for i, name in enumerate(names)}
    zero = np.zeros(len(UPPER))
    return lambda weights: float(np.max(sum((w * opens.get(name, zero) for name, w in weights.items()), zero)))


def counted(said: Iterable[Said], gap: Callable[[Mapping[str, float]], float], fps: float) -> tuple[int, int, int, int]:
    """Phonemes that close the lips: how many did and how many there are; the same of those that do not."""
    did = should = wrong = others = 0
    for one in said:
        speaking = Speaking(one.sound)
        times = np.arange(0, one.sound.seconds, 1 / fps)
        closed: NDArray[np.bool_] = np.array([gap(speaking.at(t)) <= SLACK for t in times])
        for phoneme, begin, end in one.phonemes:
            viseme = visemes_of(phoneme)[0]
            if viseme == "PP":
                near = (times >= begin - AROUND) & (times <= end + AROUND)
                should, did = should + 1, did + bool(closed[near].any())
            elif viseme not in ("sil", "FF"):
                during = closed[(times >= begin) & (times <= end)]
                others, wrong = others + 1, wrong + bool(len(during) and during.all())
    return did, should, wrong, others


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("face", type=Path)
    measure = gap_of(parser.parse_args().face)
    voices: dict[str, Callable[[str], Said]] = {"espeak en": espeak}
    voices["espeak en-us+f3, 150 words"] = partial(espeak, voice="en-us+f3", words=150, pitch=60)
    voices["espeak en+m5, 200 words"] = partial(espeak, voice="en+m5", words=200, pitch=40)
    voices |= {f"flite {voice}": partial(flite, voice=voice) for voice in ("slt", "awb")}
    for what, sentences in (("developed", DEVELOPED), ("set aside", SET_ASIDE)):
        for name, say in voices.items():
            for fps in (100.0, 30.0):
                did, should, wrong, others = counted(map(say, sentences), measure, fps)
                rate, false = 100 * did / should, 100 * wrong / others
                print(f"{what}, {name}, {fps:g} a second: {did}/{should} closed ({rate:.0f} %), others {false:.1f} %")
