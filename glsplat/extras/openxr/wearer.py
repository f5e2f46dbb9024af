"""Wearer: the state of a session's user: view, gestures and standing place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from glsplat.extras.openxr.cameras import matrix_of
from glsplat.extras.openxr.openxr.runtime import OpenXrRuntime
from glsplat.extras.openxr.placing import VIEWS, Place, ViewName, placing, standing
from glsplat.extras.openxr.runtime import Devices, FrameTiming
from glsplat.extras.openxr.samples import pinched, sample_of
from glsplat.tracking.sample import Sample

_DOUBLE = 0.5  # most seconds between two pinches of the left hand that select the next view
_IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_STALE = 2.0  # seconds without a frame (the headset was off) after which the view is placed again


@dataclass(frozen=True, slots=True)
class Moment:
    """The user at one frame."""

    sample: Sample
    devices: Devices
    place: Place


class Wearer:
    """A session's user; call ``look`` once a frame. ``room``: a server's room with others (docs/protocol.md, 2.1)."""

    def __init__(
        self, view: ViewName = "mirror", room: bool = False, heard: Callable[[Sample], None] = lambda _: None
    ) -> None:
        self.view: ViewName = view
        self.room = room
        self._heard = heard  # receives every sample
        self._place: Place | None = None
        self._stood = not room
        self._moved = False  # whether the space was moved to the standing place
        self._pressed = self._pinching = False
        self._pinched = self._last = float("-inf")

    def look(self, runtime: OpenXrRuntime, timing: FrameTiming, focused: bool) -> Moment | None:
        """Return the user at the frame's display time; None until the head was tracked once."""
        now = timing.display_time * 1e-9
        devices = runtime.devices(timing.display_time, focused)
        if devices.head is not None and not self._stood:
            if self._moved:  # the standing place is in the runtime's own space
                runtime.move(_IDENTITY)
                devices = runtime.devices(timing.display_time, focused)
        if devices.head is not None and not self._stood:
            x, z, sine, cosine = standing(matrix_of(devices.head))
            runtime.move((x, 0.0, z, 0.0, sine, 0.0, cosine))
            self._stood = self._moved = True
            self._place = None
            devices = runtime.devices(timing.display_time, focused)
        if now - self._last > _STALE:
            self._place = None
        self._last = now
        if focused:  # pinches in the runtime's own menu do not count
            self._gestures(devices, now)
        if devices.head is not None and self._place is None:
            self._place = placing(self.view, matrix_of(devices.head), self.room)
        sample = sample_of(devices, now)
        self._heard(sample)
        return None if self._place is None else Moment(sample, devices, self._place)

    def next_view(self) -> None:
        """Show the next of mirror, facing and own body, placed in front of the user."""
        self.show(VIEWS[(VIEWS.index(self.view) + 1) % len(VIEWS)])

    def show(self, view: ViewName) -> None:
        """Show this view, placed in front of the user."""
        self.view, self._place = view, None

    def recentred(self) -> None:
        """Place the view in front of the user again: the origin of their space has changed."""
        self._place = None
        self._stood = not self.room

    def _gestures(self, devices: Devices, now: float) -> None:
        """Go to the next view at button A or X, or two pinches of the left hand."""
        if devices.next_view and not self._pressed:
            self.next_view()
        self._pressed = devices.next_view
        pinching = pinched(devices.hands[0], self._pinching)
        if pinching and not self._pinching:
            if now - self._pinched < _DOUBLE:
                self.next_view()
                self._pinched = float("-inf")
            else:
                self._pinched = now
        self._pinching = pinching
