"""Answer with poses as soon as a sample is solved, on the event loop, without the renderer.

A request for poses passes through its session as others do: the newest wins, at most a window of answers is under way,
and answers keep the order of their requests, even if a client changes between pictures and poses.
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
from glsplat.net.client_stream import ClientStream, Outgoing, PoseAnswer, Refused
from glsplat.net.codec.body import AT_ORIGIN, Placement, Poses, pack_body
from glsplat.net.messages import Request
from glsplat.net.reply import pack_poses
from glsplat.skinning.pose import Pose

log: logging.Logger = logging.getLogger("glsplat.net")

NO_POSE = "no_pose"
"""Code of the error for an avatar that clients cannot draw."""


class PoseResponder:
    """Answers requests for poses. ``sha256`` returns the hash of an avatar's file; None if it is not available now.

    ``withheld`` returns why consent withholds it; "" if it does not.
    """

    def __init__(
        self,
        sha256: Callable[[str], bytes | None],
        withheld: Callable[[str], str],
        clock: Callable[[], float] = time.perf_counter,  # seconds; the render loop's
    ) -> None:
        self._sha256, self._withheld, self._clock = sha256, withheld, clock

    def due(self, client: ClientStream) -> None:
        """Answer all of this client's requests for poses that are ready."""
        if client.session.drawing:  # its picture is sent first
            return
        loop = asyncio.get_running_loop()
        while client.ready(partial(self._solved, loop, client), poses=True):
            client.answers.put_nowait(self._answer(client))

    def pack(self, answer: PoseAnswer) -> Outgoing:
        """Pack an answer for sending, and mark its request as being sent."""
        request, client, poses = answer.request, answer.client, answer.poses
        assert request.frame_id is not None
        now = self._clock()
        times = {**answer.times, "total": (now - answer.arrived) * 1e3}
        info: dict[str, Any] = {
            "t": request.t,
            "want": "pose",
            "now": round(now * 1e3, 3),
            "times": {name: round(ms, 3) for name, ms in times.items()},
            "dropped": client.session.counts.dropped,
            "driven_by": client.driver,
        }
        if answer.notes is not None:
            info["tracking"] = answer.notes
        if poses.room is not None:
            info["room"] = poses.room
        client.session.sending(request)
        return Outgoing(request, [pack_poses(request.frame_id, info, poses.bodies)])

    def _solved(self, loop: asyncio.AbstractEventLoop, client: ClientStream) -> None:
        """Answer a client whose sample is solved. Runs on the solving thread."""
        with suppress(RuntimeError):  # the server has stopped
            loop.call_soon_threadsafe(self.due, client)

    def _answer(self, client: ClientStream) -> PoseAnswer | Refused:
        now = self._clock()
        request, waited, solution = client.take(now)
        arrived, times, solved = now - waited, {"wait": waited * 1e3}, None
        try:
            if request.tracking is not None:
                if solution is None:
                    raise PoseError(client.untracked)
                solved, ms = solution.result()
                times |= {"wait": times["wait"] - ms, "ik": ms}
            poses = self._poses(client, request, arrived, solved, now)
        except PoseError as error:
            return Refused(request, "bad_pose", str(error))
        except Exception:  # a fault of the server costs this answer
            log.exception("request %s of client %d cannot be answered", request.frame_id, client.number)
            return Refused(request, "render", "the pose could not be solved")
        if isinstance(poses, str):
            return Refused(request, NO_POSE, poses)
        return PoseAnswer(client, request, arrived, times, poses, None if solved is None else solved.notes)

    def _poses(
        self, client: ClientStream, request: Request, arrived: float, solved: Solved | None, now: float
    ) -> Poses | str:
        """Return the poses that changed in the room, or that of the one avatar; or the reason for none.

        Raises PoseError.
        """
        if client.member is not None:
            return client.member.poses(client.pose_history, self._sha256, now)
        name, skeleton = client.shown.name, client.shown.skeleton
        sha256 = self._sha256(name)
        if sha256 is None:
            return self._withheld(name) or f'"{name}" cannot be drawn by a browser: request pictures'
        pose = request.pose or Pose.zero(55 if skeleton is None else len(skeleton))
        place = AT_ORIGIN
        if solved is not None:
            pose, place = solved.pose, Placement((0.0, solved.floor, 0.0), scale=solved.scale)
        assert request.frame_id is not None
        return Poses(
            [pack_body(pose, sha256, place, at=arrived * 1e3, t=request.t, frame_id=request.frame_id, you=True)]
        )
