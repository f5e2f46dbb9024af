"""A face tracked by another program: its last values, and its wearer. No sockets; times are passed in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import exp
from threading import Lock

from glsplat.errors import ProtocolError
from glsplat.extras.speech.face.osc import osc_messages
from glsplat.extras.speech.face.unified import gaze_of, parameter_of, weights_of
from glsplat.tracking.sample import Sample

HOLD_S = 0.5  # time without a packet for which the face keeps its shape ...
RELAX_S = 0.25  # ... and the time constant of its relaxation afterwards
FORGET_S = 3.0  # time without a packet after which all values are dropped
WEARER_TIMEOUT_S = 2.0  # time without a sample of the wearer after which another user may have the face
_MAX_VALUE = 2.0  # of a parameter; larger ones are invalid


class FaceFeed:
    """One face, worn by one user at a time: the first one, until no samples came for WEARER_TIMEOUT_S. Thread-safe."""

    def __init__(self) -> None:
        self.malformed = 0  # packets
        self._values: dict[str, float] = {}  # by parameter; bounded by the known names
        self._received = float("-inf")
        self._wearer: object = None
        self._worn_at = float("-inf")
        self._lock = Lock()

    def receive(self, packet: bytes, now: float) -> None:
        """Read a packet. Malformed ones are counted, unknown parameters ignored."""
        try:
            for address, arguments in osc_messages(packet):
                name = parameter_of(address)
                value = float(arguments[0]) if name is not None and arguments else None
                if name is not None and value is not None and abs(value) <= _MAX_VALUE:  # NaN fails this
                    with self._lock:
                        self._values[name] = value
                        self._received = now
        except ProtocolError:
            self.malformed += 1

    def face(self, now: float) -> tuple[Mapping[str, float], Mapping[str, float]]:
        """Return the weights of ARKit's shapes and their parameters; both empty without a tracked face."""
        with self._lock:
            age = now - self._received
            if age > FORGET_S:
                self._values.clear()
            values = dict(self._values)
        rest = exp(-max(0.0, age - HOLD_S) / RELAX_S)
        return {name: weight * rest for name, weight in weights_of(values).items()}, values if age <= HOLD_S else {}

    def worn(self, wearer: object, sample: Sample, now: float) -> Sample:
        """Return a user's sample with the face, if the user wears it; the sample's own values take precedence."""
        with self._lock:
            if wearer is not self._wearer and now - self._worn_at < WEARER_TIMEOUT_S:
                return sample
            self._wearer, self._worn_at = wearer, now
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
