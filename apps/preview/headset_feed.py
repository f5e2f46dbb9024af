"""Show a server's pictures in a headset: send the wearer's eyes and tracking, submit the newest pair.

A pair is submitted with the eye poses of its request, so that the runtime reprojects it correctly if it is late.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from glsplat.camera import Camera
from glsplat.extras.openxr.eyes import Surroundings
from glsplat.extras.openxr.openxr.runtime import OpenXrRuntime
from glsplat.extras.openxr.placing import Place, camera_of, sighted, surroundings
from glsplat.extras.openxr.runtime import FrameTiming, Projection, ViewPose
from glsplat.extras.openxr.session import Shown
from glsplat.extras.openxr.swapchains import EyeSwapchains, fitting
from glsplat.extras.openxr.wearer import Wearer
from glsplat.gl.context import Context
from glsplat.renderer.targets import Target
from glsplat.rotations import FLIP_X

from .feed import Feed, Picture, ViewRequest


@dataclass(frozen=True, eq=False)
class _Subject:
    """Eye poses and placement of a request."""

    views: Sequence[ViewPose]
    place: Place


class FeedShow:
    """A ``Show`` of a server's pictures. The caller owns the feed and closes it later."""

    def __init__(
        self,
        feed: Feed,
        context: Context,
        wearer: Wearer,
        *,
        scale: float = 1.0,
        floor: bool = True,
        transparent: bool = False,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._feed, self._context, self.wearer, self._say = feed, context, wearer, say
        self._scale, self._floor, self._transparent = scale, floor and not transparent, transparent
        self._size = (0, 0)  # of requested pictures
        self.eyes: EyeSwapchains | None = None  # the runtime's images; None before the first picture
        self._last: Projection | None = None
        self._said = ""
        self._target: Target | None = None
        self._around: Surroundings | None = None
        self.pictures = 0
        self.age_ms = 0.0  # of the newest picture when it was submitted

    def attach(self, runtime: OpenXrRuntime) -> None:
        """Read the runtime's picture size. Images are made when the server's first picture arrives."""
        self._size = fitting(runtime, self._scale, self._context.max_size)

    def detach(self) -> None:
        """Release the images."""
        eyes, self.eyes, self._last = self.eyes, None, None
        if eyes is not None:
            eyes.close()
        self.recentred()

    def recentred(self) -> None:
        """Recentre the view."""
        self.wearer.recentred()

    def frame(self, runtime: OpenXrRuntime, timing: FrameTiming, focused: bool) -> Shown:
        """Request a pair for this frame; submit the newest one received."""
        moment = self.wearer.look(runtime, timing, focused)
        views = sighted(runtime.views(timing.display_time))
        located = time.perf_counter()
        if self._feed.notice != self._said:
            self._said = self._feed.notice
            if self._said:
                self._say(self._said)
        if views is not None and moment is not None and moment.sample.head is not None:
            self._feed.request(self._request_for(views, moment.place, moment.sample.to_json()))
        picture, drawing = self._feed.take(), 0.0
        if picture is not None and isinstance(picture.about, _Subject) and len(picture.images) == 2:
            begun = time.perf_counter()
            self._submit(runtime, picture, picture.about)
            drawing = time.perf_counter() - begun
        return Shown(self._last, located, drawing)

    def look(self, framebuffer: moderngl.Framebuffer, size: tuple[int, int], eye: int = 0) -> bool:
        """Draw the last submitted picture into ``framebuffer``; return False if there is none."""
        if self.eyes is None or self._target is None or self._last is None:
            return False
        self.eyes.show(self._target, framebuffer, size, self._around, eye)
        return True

    def release(self) -> None:
        """Delete all GL objects."""
        self.detach()
        if self._target is not None:
            self._target.release()
            self._target = None

    def _request_for(self, views: Sequence[ViewPose], place: Place, tracking: dict[str, Any]) -> ViewRequest:
        mirror = place.glass is not None
        shown = place.shown @ FLIP_X if mirror else place.shown  # the server mirrors the avatar
        cameras: list[Camera] = [camera_of(view, self._size, shown) for view in views]
        options: dict[str, Any] = {}
        if mirror:
            options["mirror"] = True
        if place.view == "own":
            options["hide"] = ("head",)
        if self._transparent or not mirror:  # a mirror's glass is opaque black
            options["alpha"] = "straight"
        return ViewRequest(cameras, tracking=tracking, options=options, about=_Subject(tuple(views), place))

    def _submit(self, runtime: OpenXrRuntime, picture: Picture, subject: _Subject) -> None:
        _, height, width, _ = picture.images.shape
        size = (width, height)
        if self.eyes is None or self.eyes.size != size:
            if self.eyes is not None:
                self._last = None
                self.eyes.close()
            self.eyes = EyeSwapchains(runtime, self._context, size, False)
        with self._context.entered("FeedShow"):
            if self._target is None or self._target.shape != picture.images.shape:
                if self._target is not None:
                    self._target.release()
                self._target = Target(self._context.ctx, *size, 2, "f1")
            self._target.texture.write(np.ascontiguousarray(picture.images))
        self._around = surroundings(subject.views, size, subject.place, self._floor)
        self.eyes.fill(self._target, None, self._around)
        self._last = self.eyes.projection(subject.views, None, self._transparent)
        self.pictures += 1
        self.age_ms = (time.perf_counter() - picture.requested_at) * 1e3
