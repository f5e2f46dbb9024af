"""Parameters of speech analysis: web/voice/visemes.json, shared with the page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Framing:
    """Framing of sound. Times in seconds, frequencies in hertz; levels are powers relative to full scale."""

    hop: float  # seconds from frame to frame
    window: float  # seconds of a frame
    bands: int  # on the mel scale from ``low`` to ``high``
    low: float
    high: float
    coefficients: int  # of the cosine transform over the bands
    tiny: float  # fraction of the peak below which sound counts as silence
    start: float  # initial level of the peak ...
    least: float  # ... and its minimum
    half_life: float  # seconds in which the peak falls by half


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Parameters made by ``tools/data/visemes.py``."""

    framing: Framing
    ahead: int  # later frames used for a frame
    offsets: tuple[int, ...]  # of the frames used, from the newest
    hidden: tuple[NDArray[np.float64], NDArray[np.float64]]  # [offsets * coefficients, H], [H]
    output: tuple[NDArray[np.float64], NDArray[np.float64]]  # [H, V], [V]
    visemes: Mapping[str, Mapping[str, float]]  # weights of ARKit's shapes by viseme
    closes: str  # the viseme with closed lips
    closed: tuple[float, float]  # its probability at which lips begin to close, and are closed
    opens: float  # seconds in which closed lips open
    smooth: float  # seconds, time constant of all other movements
    least: float  # weights below it are noise
    jaw: tuple[float, float]  # share of jawOpen in silence, and decibels below the peak of silence


@cache
def table() -> Table:
    """Return the parsed table."""
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
