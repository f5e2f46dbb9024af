"""One avatar on its way: what it is to be made of, who makes it, and how far that is. Values only."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError

__all__ = [
    "VIEWS",
    "WORDS",
    "Finding",
    "Job",
    "LowConfidenceError",
    "Make",
    "Order",
    "Progress",
    "UploadConfig",
    "bounded",
    "notes_of",
]

VIEWS = ("front", "back", "left", "right")
"""The sides of a person that pictures may show; the first is needed."""

_STEPS = 40  # that are told of a job
WORDS = 300
"""Characters of a line that is told."""

Finding = tuple[str, str, str]
"""What is wrong with a picture: the side of the person that it shows, a word for programs, a line for people."""

Progress = Callable[[str, float], None]
"""Told of each step by its name, and the share of it that is done."""


class LowConfidenceError(GlsplatError):
    """The pictures are not what an avatar should be made of; it may be asked for all the same."""

    def __init__(
        self, message: str, findings: Sequence[Finding] = (), go_on: Callable[[], Avatar] | None = None
    ) -> None:
        super().__init__(message)
        self.findings: tuple[Finding, ...] = tuple(findings)
        self.go_on: Callable[[], Avatar] | None = go_on
        """Makes it all the same, from what is known by now; None where it cannot be made. In the maker's process."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Order:
    """What a client sent. Its pictures are nowhere but in here and in the process that looks at them."""

    pictures: Mapping[str, bytes]  # files as they came, by what of VIEWS they show
    height: float | None = None  # metres
    anyway: bool = False  # make it of doubtful pictures, too
    title: str = ""  # what its owner calls it


Make = Callable[[Order, Progress], Avatar]
"""Makes an avatar, in a process of its own: a picklable function.

Raises LowConfidenceError, or GlsplatError in one line.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadConfig:
    """What a server lets its clients make."""

    folder: Path  # where the avatars are kept, as NAME.glb
    make: Make
    signed: Callable[[str, bytes, str], bytes] | None = None
    """Called on any thread with an avatar's name, its file and the account that asked ("": none); the file to keep."""
    picture_bytes: int = 20_000_000  # a picture
    body_bytes: int = 45_000_000  # all pictures of one avatar
    most_files: int = 50  # avatars in the folder
    folder_bytes: int = 1_000_000_000
    avatar_bytes: int = 100_000_000
    waiting: int = 2  # jobs beside the one that is worked on; those whose pictures still come are among them
    per_address: int = 2  # jobs of one address
    senders: int = 1  # of them, whose pictures still come
    seconds: float = 600.0  # a job may take, from when it is worked on
    receive: float = 120.0  # seconds that the pictures may take to come
    rate: float = 4000.0  # bytes of them a second, at least
    stall: float = 10.0  # seconds that they may be behind that rate, also at the start
    patience: float = 120.0  # seconds that a refused job's process waits for the word to go on all the same
    nice: int = 10  # of the process that works, so that drawing goes first


State = Literal["receiving", "waiting", "making", "done", "failed"]


@dataclass(eq=False, slots=True)
class Job:
    """``name`` is the avatar's. The thread that works tells of steps; all else is the event loop's."""

    name: str
    address: str
    account: str = ""  # of whoever asked
    state: State = "receiving"
    order: Order | None = None  # until it is worked on
    steps: list[str] = field(default_factory=list)
    share: float = 0.0  # of the last step
    error: str = ""
    findings: tuple[Finding, ...] = ()  # what refused it
    notes: tuple[Finding, ...] = ()  # what the avatar was guessed from
    ended: float | None = None  # on the clock of time.monotonic()
    goes_on: bool = False  # it failed, and can go on where it was
    cancelled: bool = False

    def progress(self, step: str, share: float) -> None:
        """The work is at ``step``, ``share`` of which is done."""
        step = step.partition(", error ")[0][:WORDS]  # a number that changes is no other step
        if (not self.steps or self.steps[-1] != step) and len(self.steps) < _STEPS:
            self.steps.append(step)
        self.share = min(1.0, max(0.0, share))

    def fail(self, error: str, findings: Sequence[Finding] = (), goes_on: bool = False) -> None:
        """It comes to nothing, unless it ``goes_on``."""
        self.state, self.order, self.ended, self.goes_on = "failed", None, time.monotonic(), goes_on
        self.error = error[:WORDS]
        self.findings = bounded(findings)

    def again(self) -> None:
        """It is wanted all the same."""
        self.state, self.ended, self.goes_on, self.error, self.findings = "waiting", None, False, "", ()

    def done(self, notes: Sequence[Finding] = ()) -> None:
        """The avatar is offered."""
        self.state, self.share, self.ended = "done", 1.0, time.monotonic()
        self.notes = bounded(notes)

    def status(self, ahead: int) -> dict[str, Any]:
        """What clients are told; ``ahead``: jobs that come before this one."""
        return {
            "name": self.name,
            "state": self.state,
            "ahead": ahead,
            "steps": list(self.steps),
            "share": round(self.share, 3),
            "error": self.error or None,
            "goes_on": self.goes_on,
            "findings": [
                {"side": side, "code": code, "kind": kind, "text": text}
                for kind, found in (("refusal", self.findings), ("note", self.notes))
                for side, code, text in found
            ],
        }


def notes_of(meta: Mapping[str, Any]) -> tuple[Finding, ...]:
    """What an avatar's own notes say that it was guessed from; nothing where they say it otherwise."""
    told = meta.get("guessed")
    found = [each for each in told if isinstance(each, Mapping)] if isinstance(told, (list, tuple)) else []
    return tuple((str(one.get("side")), str(one.get("code")), str(one.get("text"))) for one in found)


def bounded(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """As many findings as are told of a job, in as many characters."""
    return tuple((side[:WORDS], code[:WORDS], text[:WORDS]) for side, code, text in findings[:_STEPS])
