"""Show a server's pictures in the preview's window: send view requests, upload the newest picture."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import moderngl
import numpy as np

from glsplat.camera import Camera
from glsplat.errors import GlsplatError
from glsplat.renderer.pipeline import view_state
from glsplat.renderer.targets import Target
from glsplat.scene import SceneLike
from glsplat.skinning.pose import EXPRESSION
from glsplat.skinning.smplx import JOINT_NAMES

from ..replay.command import Recording, load_drive
from .feed import MIN_PERIOD_S, Feed, Picture, ViewRequest
from .overlay import Line
from .player import Player, Tracked

_RATE_HZ = 72.0  # of samples sent


def read_tracked(name: str | None) -> Tracked:
    """Return a recording of head and hands (.jsonl, or the embedded one), resampled to the newest sample at 72 Hz.

    Raises FormatError, which names the file.
    """
    if name is not None and not name.lower().endswith(".jsonl"):
        raise GlsplatError(f"{name}: a recording of head and hands ends in .jsonl")
    recording, seconds = load_drive(name)
    if not isinstance(recording, Recording):
        raise GlsplatError("this installation has no recording of its own; give --recording a file")
    count = max(1, min(round(seconds * _RATE_HZ), 4 * len(recording.samples)))  # limits the memory for a long gap
    samples = [recording.at((i + 0.5) / _RATE_HZ).tracking or {} for i in range(count)]
    zeros = np.zeros((count, len(JOINT_NAMES), 3))
    label = Path(name).stem if name else "recording"
    return Tracked(_RATE_HZ, zeros, zeros[:, 0], JOINT_NAMES, label, samples=samples)


class StreamedPictures:
    """Pictures drawn by a server. The caller owns the feed and closes it later."""

    period_s = MIN_PERIOD_S

    def __init__(self, feed: Feed, context: moderngl.Context) -> None:
        self._feed, self._ctx = feed, context
        self._requested: tuple[object, ViewRequest] | None = None  # with its state, which may be a sample's id
        self._picture: Picture | None = None
        self._shown = 0
        self._age_ms = 0.0
        self._target = Target(context, 1, 1, 1, "f1")  # black until the first picture
        self._target.texture.write(bytes(4))

    @property
    def notice(self) -> str:
        """Problem of the connection, or \"\"."""
        return self._feed.notice

    @property
    def fresh(self) -> bool:
        """Whether a picture is queued."""
        return self._feed.ready

    def request(self, cameras: Sequence[Camera], player: Player | None) -> bool:
        """Send the view if it changed; return whether a newer picture is queued."""
        request, state = _request_for(cameras, player)
        if self._requested is None or state != self._requested[0]:
            self._requested = state, request
            self._feed.request(request)
        return self._feed.ready

    def wait_ready(self) -> None:
        """Wait for the reply to the newest request. Raises GlsplatError if there is none."""
        self._feed.wait_ready()

    def draw(self, cameras: Sequence[Camera], player: Player | None, exact: bool) -> Target:
        """Return the newest picture, scaled to the window's size while that changes."""
        size = cameras[0].width, cameras[0].height
        picture = self._feed.take()
        if picture is not None:
            self._picture = picture
            self._shown += 1
            self._age_ms = (time.perf_counter() - picture.requested_at) * 1e3
        if self._picture is not None and (picture is not None or self._target.shape[2:0:-1] != size):
            self._upload(self._picture, size)
        return self._target

    def load(self, scene: SceneLike) -> None:
        """Raise GlsplatError: only the server can change the scene."""
        raise GlsplatError("the server chooses what is shown: start it with `glsplat serve FILE`")

    def facts(self) -> list[Line]:
        """Return the server's driver, the picture's bytes and age, and counts."""
        if self._picture is None:
            return [("no picture yet",)]
        info = self._picture.info
        still = [(f"the server does not apply poses: {info['still']}",)] if info.get("still") else []
        return [
            *still,
            (str(info.get("driver", "")),),
            (
                f"frame {self._picture.frame_id}: {self._picture.nbytes / 1e3:.0f} kB, "
                f"{self._age_ms:.0f} ms after it was asked for",
            ),
            (f"{self._shown} shown, {info.get('dropped', 0)} dropped by the server, {self._feed.late} late",),
        ]

    def stages(self) -> dict[str, float]:
        """Return the server's stages, the communication and the decoding, in milliseconds."""
        if self._picture is None:
            return {}
        times = self._picture.info.get("times", {})
        stages = {name: float(times[name]) for name in ("wait", "ik", "render", "encode") if name in times}
        return stages | {"communication": self._picture.communication_ms, "decode": self._picture.decode_ms}

    def report(self) -> dict[str, Any]:
        """Return address, driver, counts and the stage times of the newest picture."""
        info: Mapping[str, Any] = {} if self._picture is None else self._picture.info
        return {
            "url": self._feed.url,
            "driver": info.get("driver", ""),
            "shown": self._shown,
            "dropped": info.get("dropped", 0),
            "late": self._feed.late,
            "reconnects": self._feed.reconnects,
            "bytes": 0 if self._picture is None else self._picture.nbytes,
            "age_ms": round(self._age_ms, 3),
            "timings_ms": {name: round(ms, 3) for name, ms in self.stages().items()},
        }

    def release(self) -> None:
        """Delete the texture."""
        self._target.release()

    def _upload(self, picture: Picture, size: tuple[int, int]) -> None:
        images = picture.images
        if images.shape[2:0:-1] != size:
            images = np.stack([cv2.resize(image, size, interpolation=cv2.INTER_LINEAR) for image in images])
        if self._target.shape != images.shape:
            self._target.release()
            self._target = Target(self._ctx, *size, len(images), "f1")
        self._target.texture.write(images)


def _request_for(cameras: Sequence[Camera], player: Player | None) -> tuple[ViewRequest, object]:
    """Return the request of a view (tracking samples of a recording, else a pose), and a state that changes with it."""
    views = tuple(map(view_state, cameras))
    if player is None:
        return ViewRequest(cameras), views
    if isinstance(player.motion, Tracked):
        sample = player.motion.samples[player.frame]
        return ViewRequest(cameras, tracking=sample), (views, id(sample))
    pose, names = player.pose(), player.skeleton.names
    arrays = (pose.rotations, pose.trans, pose.translations)
    state = (views, *(array is not None and array.tobytes() for array in arrays), dict(pose.expression))
    if names == JOINT_NAMES:
        return ViewRequest(cameras, pose), state
    joints: dict[str, Any] = {"joints": dict(zip(names, pose.rotations, strict=True)), "trans": pose.trans}
    if pose.translations is not None:
        joints["translations"] = dict(zip(names, pose.translations, strict=True))
    if pose.expression:
        joints[EXPRESSION] = dict(pose.expression)
    return ViewRequest(cameras, joints), state
