"""The table of sound to mouth shapes, visemes.json, which the page reads too."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

__all__ = ["Framing", "Table", "table"]


@dataclass(frozen=True, slots=True)
class Framing:
    """How sound is cut and counted. Seconds, hertz; levels are powers, 1 is that of full scale."""

    hop: float  # seconds from frame to frame
    window: float  # seconds of a frame
    bands: int  # of the mel scale, from ``low`` to ``high``
    low: float
    high: float
    coefficients: int  # of the cosine transform over the bands
    tiny: float  # of the peak; what is quieter is silence
    start: float  # level of the peak that is expected before any sound came
    least: float  # ... and below which it never falls
    half_life: float  # seconds in which the peak falls by half


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """What ``tools/data/visemes.py`` found and chose."""

    framing: Framing
    ahead: int  # frames that are heard before a frame is judged
    offsets: tuple[int, ...]  # of the frames that are looked at, from the newest
    hidden: tuple[NDArray[np.float64], NDArray[np.float64]]  # [offsets * coefficients, H], [H]
    output: tuple[NDArray[np.float64], NDArray[np.float64]]  # [H, V], [V]
    visemes: Mapping[str, Mapping[str, float]]  # weights of ARKit's shapes, by the names of visemes
    closes: str  # the viseme with closed lips
    closed: tuple[float, float]  # its probability at which lips begin to close, and at which they are
    opens: float  # seconds in which lips that were closed open again
    smooth: float  # seconds, time constant of the others
    least: float  # weight that counts: what is below is no mouth that moves but doubt
    jaw: tuple[float, float]  # share of jawOpen in silence, and decibels below the peak that count as silence


@cache
def table() -> Table:
    """Return the table of web/voice/visemes.json, which the page reads, too."""
    found = json.loads((resources.files("glsplat.extras.speech") / "web" / "voice" / "visemes.json").read_bytes())
    sound, net, mouth = found["sound"], found["network"], found["mouth"]
    return Table(
        framing=Framing(**sound),
        ahead=net["ahead"],
        offsets=tuple(net["offsets"]),
        hidden=(np.array(net["hidden"]), np.array(net["hidden_bias"])),
        output=(np.array(net["output"]), np.array(net["output_bias"])),
        visemes=MappingProxyType({name: MappingProxyType(weights) for name, weights in found["visemes"].items()}),
        closes=mouth["closes"],
        closed=tuple(mouth["closed"]),
        opens=mouth["opens"],
        smooth=mouth["smooth"],
        least=mouth["least"],
        jaw=tuple(mouth["jaw"]),
    )
