"""The face that is tracked beside the headset: what came of it, and whose it is. No sockets; times come in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import exp
from threading import Lock

from glsplat.errors import ProtocolError
from glsplat.extras.speech.face.osc import osc_messages
from glsplat.extras.speech.face.unified import gaze_of, parameter_of, weights_of
from glsplat.tracking.sample import Sample

__all__ = ["FaceFeed"]

HELD = 0.5  # seconds without a packet in which the face stays as it is ...
RELAXES = 0.25  # ... and the time constant with which it comes to rest then
FORGOTTEN = 3.0  # seconds after which nothing of it is left
LEFT = 2.0  # seconds without a sample of the wearer after which another one may have the face
_FARTHEST = 2.0  # of a parameter; what is beyond is no share of anything


class FaceFeed:
    """One face, worn by one user at a time: whose samples come first has it, until none have come for two seconds.

    May be used by several threads.
    """

    def __init__(self) -> None:
        self.malformed = 0  # packets
        self._values: dict[str, float] = {}  # by parameter: no more than there are names
        self._came = float("-inf")
        self._wearer: object = None
        self._worn = float("-inf")
        self._lock = Lock()

    def heard(self, packet: bytes, now: float) -> None:
        """A packet came. What is no OSC is counted, what is not known is left out."""
        try:
            for address, arguments in osc_messages(packet):
                name = parameter_of(address)
                value = float(arguments[0]) if name is not None and arguments else None
                if name is not None and value is not None and abs(value) <= _FARTHEST:  # NaN fails this
                    with self._lock:
                        self._values[name] = value
                        self._came = now
        except ProtocolError:
            self.malformed += 1

    def face(self, now: float) -> tuple[Mapping[str, float], Mapping[str, float]]:
        """Weights of ARKit's shapes, and the parameters they came from; both empty where no face is tracked."""
        with self._lock:
            age = now - self._came
            if age > FORGOTTEN:
                self._values.clear()
            values = dict(self._values)
        rest = exp(-max(0.0, age - HELD) / RELAXES)
        return {name: weight * rest for name, weight in weights_of(values).items()}, values if age <= HELD else {}

    def worn(self, wearer: object, sample: Sample, now: float) -> Sample:
        """The sample of a user with the face, if it is theirs; what it says of its face itself wins."""
        with self._lock:
            if wearer is not self._wearer and now - self._worn < LEFT:
                return sample
            self._wearer, self._worn = wearer, now
        weights, values = self.face(now)
        if not weights:
            return sample
        left, right = (gaze_of(values, side) for side in ("Left", "Right"))
        return replace(
            sample,
            expression={**weights, **(sample.expression or {})},
            left_eye=left if sample.left_eye is None else sample.left_eye,
            right_eye=right if sample.right_eye is None else sample.right_eye,
        )
