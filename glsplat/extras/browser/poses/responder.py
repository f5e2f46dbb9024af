"""Answers in poses: as soon as a sample is solved, on the event loop, without a turn of the renderer.

A request for poses goes the way of every other through its session: the newest wins, at most a window of answers is
under way, and answers keep the order of their requests, also where a client goes from pictures to poses and back.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from glsplat.errors import PoseError
from glsplat.net.backend import Solved
from glsplat.net.client_stream import ClientStream, Frame
from glsplat.net.codec.body import HERE, Place, Poses, pack_body
from glsplat.net.reply import pack_poses
from glsplat.skinning.pose import Pose

__all__ = ["NO_POSE", "PoseResponder"]

log: logging.Logger = logging.getLogger("glsplat.net")

NO_POSE = "no_pose"
"""The code of the error for a client that cannot draw whom it is shown."""


class PoseResponder:
    """``sha256`` returns the hash of an avatar's file, or None where it is not handed out now.

    ``withheld`` returns why consent keeps it back; "" where it does not.
    """

    def __init__(
        self,
        sha256: Callable[[str], bytes | None],
        withheld: Callable[[str], str],
        clock: Callable[[], float] = time.perf_counter,  # seconds; the render loop's
    ) -> None:
        self._sha256, self._withheld, self._clock = sha256, withheld, clock

    def due(self, channel: ClientStream) -> bool:
        """Answer what this client asked to be told in poses, if that can be done now. Was there something?"""
        if channel.session.drawing:  # once that picture is sent
            return False
        loop, answered = asyncio.get_running_loop(), False
        while channel.ready(partial(self._solved, loop, channel), poses=True):
            channel.frames.put_nowait(self._answer(channel))
            answered = True
        return answered

    def pack(self, frame: Frame) -> list[bytes]:
        """The message of a frame with poses. Marks it as being sent."""
        request, channel, poses = frame.request, frame.channel, frame.poses
        assert poses is not None and request.frame_id is not None
        now = self._clock()
        frame.times["total"] = (now - frame.arrived) * 1e3
        info: dict[str, Any] = {
            "t": request.t,
            "want": "pose",
            "now": round(now * 1e3, 3),
            "times": {name: round(ms, 3) for name, ms in frame.times.items()},
            "dropped": channel.session.counts.dropped,
            "driven_by": channel.driver,
        }
        if frame.notes is not None:
            info["tracking"] = frame.notes
        if poses.room is not None:
            info["room"] = poses.room
        channel.session.sending(request)
        return [pack_poses(request.frame_id, info, poses.bodies)]

    def _solved(self, loop: asyncio.AbstractEventLoop, channel: ClientStream) -> None:
        """On the solving thread."""
        with suppress(RuntimeError):  # the server has stopped
            loop.call_soon_threadsafe(self.due, channel)

    def _answer(self, channel: ClientStream) -> Frame:
        now = self._clock()
        request, waited, solution = channel.take(now)
        frame = Frame(channel, request, now - waited, {"wait": waited * 1e3}, (), solution=solution)
        try:
            solved = None
            if request.tracking is not None:
                if solution is None:
                    raise PoseError(channel.untracked)
                solved, frame.times["ik"] = solution.result()
                frame.times["wait"] -= frame.times["ik"]
                frame.notes = solved.notes
            self._fill(frame, solved, now)
        except PoseError as error:
            frame.error = ("bad_pose", str(error))
        except Exception:  # a fault of ours costs this answer
            log.exception("request %s of client %d cannot be answered", request.frame_id, channel.number)
            frame.error = ("render", "the pose could not be solved")
        return frame

    def _fill(self, frame: Frame, solved: Solved | None, now: float) -> None:
        """Everybody in the room whose pose is news, or the one avatar alone. Raises PoseError."""
        channel, request = frame.channel, frame.request
        if channel.member is not None:
            frame.poses = channel.member.poses(channel.pose_history, self._sha256, now)
            return
        sha256 = self._sha256(channel.shown.name)
        if sha256 is None:
            name = channel.shown.name
            undrawable = f'"{name}" is nothing that a browser could draw: ask for pictures'
            frame.error = (NO_POSE, self._withheld(name) or undrawable)
            return
        skeleton = channel.shown.skeleton
        pose = request.pose or Pose.zero(55 if skeleton is None else len(skeleton))
        place = HERE
        if solved is not None:
            pose, place = solved.pose, Place((0.0, solved.floor, 0.0), scale=solved.scale)
        assert request.frame_id is not None
        at = frame.arrived * 1e3
        body = pack_body(pose, sha256, place, at=at, t=request.t, frame_id=request.frame_id, you=True)
        frame.poses = Poses([body])
