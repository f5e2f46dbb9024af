"""Fuzzed messages through decoder and session, without sockets.

Every message has to end in an answer the protocol knows, every request that is accepted has to be one the renderer may
draw, and a session has to stay within its window, whatever order messages and pictures come in.
"""

from __future__ import annotations

import json
import re
import time
import traceback
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.light.light import Light
from glsplat.net.backends.tracking import TrackingSolver
from glsplat.net.messages import MAX_ID, Decoder, Request, WireOptions
from glsplat.net.session import Close, Session, SessionConfig, Warn
from glsplat.tracking.calibration import Calibration
from tests.net.attacks.mutations import damaged, mutated, written
from tests.net.attacks.requests import collapsed, hands, legacy, pair, request, tracking

__all__ = ["Findings", "fuzz", "valid"]

PAGE = (Path(__file__).parents[3] / "docs" / "protocol.md").read_text(encoding="utf-8")
ERRORS = PAGE.partition("## 6.")[2].partition("## 7.")[0]
CODES = {code for cell in re.findall(r"(?m)^\| (`[^|]*)", ERRORS) for code in re.findall(r"`(\w+)`", cell)}
LIGHT = Light.preset("left").to_json()


@dataclass
class Findings:
    """What came of it."""

    outcomes: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)  # tracebacks and broken promises, each with its message
    seconds: float = 0.0

    def __str__(self) -> str:
        number = sum(self.outcomes.values())
        counts = ", ".join(f"{name} {count}" for name, count in self.outcomes.most_common())
        return f"{number} messages in {self.seconds:.0f} s, {len(self.faults)} faults; {counts}"


def valid(i: int) -> list[dict[str, Any]]:
    """One message of each form, with ids that may follow each other."""
    zeros = [[0.1, 0.0, 0.0]] * 21
    pose = {"root_pose": [0, 0.2, 0], "trans": [0, 0, 0], "body_pose": zeros, "lhand_pose": [0.1] * 45}
    full = {"tracking": tracking(i), "t": i * 4.5}
    bundle = json.loads(legacy(i))
    return [
        json.loads(request(i)),
        json.loads(request(i, pose=pose, quality=80, crop=True, t=1.5)),
        json.loads(request(i, pose=collapsed(), mirror=False, hide=["head"], box=True)),
        json.loads(request(i, eyes=pair(64, 64)[:1], size=[64, 64], ack=None)),
        json.loads(request(i, light=LIGHT, alpha="straight", depth=True)),
        json.loads(request(i, light="evening")),
        json.loads(request(i, video={"codecs": ["vp9", "h264"], "key": i % 2 == 0})),
        json.loads(request(i, **full)),
        json.loads(request(i, **full, eyes=None)),
        {"v": 1, "frame_id": i, "ack": 0, "want": "pose", **full},
        {"v": 1, "frame_id": i, "ack": 0, "want": "pose", "pose": pose, "size": [64, 64], "hide": ["head"]},
        json.loads(
            request(
                i, tracking={"head": [0, 1.6, 0, 0, 0, 0, 1], "left_grip": [0, 1, 0, 0, 0, 0, 1], "right_curl": 0.5}
            )
        ),
        json.loads(request(i, tracking={"left": None, "left_joints": [n for joint in hands(0.01) for n in joint]})),
        {"v": 1, "ack": 0},
        {"v": 1, "ack": 0, "arrival": {"age": 87.5, "held": 0.5}},
        json.loads(request(i, arrival={"age": 20, "held": 1.25}, quality=1 + i % 100)),
        bundle,
        {"frame_id": i, "cameras": [bundle["camera"], bundle["camera"] | {"eye": "right"}], "smplx": bundle["smplx"]},
    ]


FORMS = [json.dumps(form) for form in valid(1)]


class _Peer:
    """A client's session with a render loop that draws now and then; begun anew when it is closed."""

    def __init__(self, chance: Random, findings: Findings) -> None:
        self.chance, self.findings = chance, findings
        self.skeleton = default_avatar().skeleton
        self.now = 0.0
        self.begin()

    def begin(self) -> None:
        skeleton = self.skeleton if self.chance.random() < 0.8 else None
        parts = frozenset({"head"} if self.chance.random() < 0.8 else ())
        options = WireOptions(mirror=self.chance.random() < 0.2)
        self.window = self.chance.randint(1, 8)
        self.session = Session(
            Decoder(options, skeleton, parts), SessionConfig(window=self.window, max_window=self.window), self.now
        )
        self.taken: list[Request] = []
        self.newest = -1
        self.limit = options.max_side
        self.solver = TrackingSolver(self.skeleton, Calibration())

    def say(self, data: str | bytes) -> str:
        """One message; the name of what came of it."""
        self.now += self.chance.choice((0.0, 0.001, 0.01, 0.02, 1.0))
        outcome = self.session.receive(data, self.now)
        if isinstance(outcome, Warn | Close):
            error = json.loads(outcome.text)["error"]
            assert set(error) == {"code", "message", "frame_id"} and error["code"] in CODES, outcome
            assert error["message"].isprintable() and len(error["message"]) <= 300
            assert error["frame_id"] is None or 0 <= error["frame_id"] <= MAX_ID
            if isinstance(outcome, Close):
                self.begin()
                return "closed"
            return str(error["code"])
        if outcome is not None:
            self.check(outcome)
        self.render_loop()
        return "nothing asked" if outcome is None else "accepted"

    def check(self, r: Request) -> None:
        """What the renderer is promised."""
        assert r.frame_id is not None and self.newest < r.frame_id <= MAX_ID
        self.newest = r.frame_id
        assert (1 <= len(r.cameras) <= 2) != r.poses and len(r.eyes) == len(r.cameras) and set(r.eyes) <= {0, 1}
        assert r.options.hide in ((), ("head",))
        assert r.options.light is None or np.isfinite(r.options.light.uniforms()).all()
        assert 1 <= r.options.quality <= 100 and np.isfinite(r.t or 0.0)
        for camera in r.cameras:
            assert 1 <= camera.width <= self.limit and 1 <= camera.height <= self.limit
            assert np.isfinite(camera.viewmat).all() and np.isfinite(camera.K).all()
        pose = r.pose
        if r.tracking is not None and not r.fault and self.chance.random() < 0.05:
            try:
                pose = self.solver.solve(r, self.now).pose
            except GlsplatError:
                return
        if pose is not None and len(pose.rotations) == len(self.skeleton) and self.chance.random() < 0.2:
            assert np.isfinite(pose.bones(self.skeleton)).all()

    def render_loop(self) -> None:
        """Take, write or fail pictures at random; the window holds."""
        if self.chance.random() < 0.5 and (taken := self.session.next_request(self.now)) is not None:
            self.taken.append(taken[0])
            rung = None if taken[0].poses else self.session.rung(taken[0], self.now)
            assert rung is None or (1 <= rung.quality <= taken[0].options.quality and 0.5 <= rung.scale <= 1)
        if self.taken and self.chance.random() < 0.5:
            frame = self.taken.pop(0)
            if self.chance.random() < 0.9:
                self.session.sending(frame, self.chance.choice((0, 1, 100, 10**6)), self.now)
                self.session.sent(frame, 100)
            else:
                self.session.failed(frame, "render", "no")
        assert 0 <= self.session.rest(self.now) < 1e6
        status = self.session.status()
        assert status["under_way"] <= self.window and status["waiting"] <= 2
        assert status["unacknowledged"] <= self.window


def message(i: int, chance: Random) -> str | bytes:
    """The i-th message of a seed."""
    one, other = (json.loads(chance.choice(FORMS)) for _ in range(2))
    for kind_of in (one, other):
        if "frame_id" in kind_of and chance.random() < 0.95:
            kind_of["frame_id"] = i % MAX_ID
    kind = chance.random()
    if kind < 0.05:
        return written(one, chance)
    if kind < 0.70:
        return written(mutated(one, other, chance), chance)
    text = damaged(written(mutated(one, other, chance) if kind < 0.85 else one, chance), written(other, chance), chance)
    if chance.random() < 0.9:
        return text
    data = bytearray(text.encode("utf-8", "replace"))
    for _ in range(chance.randint(1, 8)):
        if data:
            data[chance.randrange(len(data))] = chance.randrange(256)
    return bytes(data)


def fuzz(number: int, seed: int, most_faults: int = 20) -> Findings:
    """``number`` messages of one seed through one session after another."""
    chance, findings = Random(seed), Findings()
    peer, start = _Peer(chance, findings), time.perf_counter()
    with np.errstate(all="raise", under="ignore"):  # a warning there would be a line in a server's log
        for i in range(number):
            data = message(i, chance)
            try:
                findings.outcomes[peer.say(data)] += 1
            except Exception:
                findings.outcomes["FAULT"] += 1
                findings.faults.append(f"{data[:2000]!r}\n{traceback.format_exc()}")
                if len(findings.faults) >= most_faults:
                    break
                peer.begin()
    findings.seconds = time.perf_counter() - start
    return findings
