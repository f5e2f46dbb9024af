"""Values of an upload: the order, the server's limits and the state of the job."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError

VIEWS = ("front", "back", "left", "right")
"""Sides of a person in pictures; the first is required."""

MAX_STEPS = 40
"""Steps, and findings, reported of a job."""
MAX_LINE = 300
"""Characters of a reported line."""

Finding = tuple[str, str, str]
"""A problem of a picture: the side of the person, a code for programs, a line for people."""

Progress = Callable[[str, float], None]
"""Called with the name of the current step and its finished share, 0 to 1."""


class LowConfidenceError(GlsplatError):
    """The pictures are too poor for a good avatar; the client may insist on one."""

    def __init__(
        self, message: str, findings: Sequence[Finding] = (), go_on: Callable[[], Avatar] | None = None
    ) -> None:
        super().__init__(message)
        self.findings: tuple[Finding, ...] = tuple(findings)
        self.go_on: Callable[[], Avatar] | None = go_on
        """Makes the avatar nevertheless, in the process that raised this; None if it cannot be made."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Order:
    """A client's order. The pictures exist only here and in the process that decodes them."""

    pictures: Mapping[str, bytes]  # encoded files by side, one of VIEWS
    height: float | None = None  # metres
    anyway: bool = False  # make the avatar even of poor pictures
    title: str = ""  # chosen by the owner


Make = Callable[[Order, Progress], Avatar]
"""Picklable function that makes an avatar in its own process. Raises LowConfidenceError or GlsplatError."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadConfig:
    """Limits and settings of a server's uploads. Times are in seconds."""

    folder: Path  # holds the avatars, as NAME.glb
    make: Make
    signed: Callable[[str, bytes, str], bytes] | None = None
    """Called on any thread with an avatar's name, file and account ("" without accounts); returns the file to keep."""
    picture_bytes: int = 20_000_000  # of one picture
    body_bytes: int = 45_000_000  # of all pictures of one avatar
    max_avatars: int = 50  # in the folder
    folder_bytes: int = 1_000_000_000
    avatar_bytes: int = 100_000_000
    waiting: int = 2  # jobs beside the one in work, including those still receiving pictures
    per_address: int = 2  # jobs of one address ...
    senders: int = 1  # ... of which still receive pictures
    make_timeout: float = 600.0
    receive_timeout: float = 120.0  # of all pictures
    rate: float = 4000.0  # bytes per second that a sender has to reach
    stall: float = 10.0  # that a sender may fall behind ``rate``, also at the start
    resume_timeout: float = 120.0  # for which a refused job's process waits for the client to insist
    nice: int = 10  # of the process that makes avatars


State = Literal["receiving", "waiting", "making", "done", "failed"]


@dataclass(eq=False, slots=True)
class Job:
    """State of a job. The worker thread calls ``progress``; everything else is set on the event loop."""

    name: str  # of the avatar
    address: str
    account: str = ""  # that sent the order
    state: State = "receiving"
    order: Order | None = None  # until the job is in work
    steps: list[str] = field(default_factory=list)
    share: float = 0.0  # of the last step that is done
    error: str = ""
    findings: tuple[Finding, ...] = ()  # reasons of a refusal
    notes: tuple[Finding, ...] = ()  # guesses made for a finished avatar
    ended: float | None = None  # time.monotonic()
    goes_on: bool = False  # whether it failed and its process can resume
    cancelled: bool = False

    def progress(self, step: str, share: float) -> None:
        """Record that ``share`` of ``step`` is done."""
        step = step.partition(", error ")[0][:MAX_LINE]  # a step whose error changes stays one step
        if (not self.steps or self.steps[-1] != step) and len(self.steps) < MAX_STEPS:
            self.steps.append(step)
        self.share = min(1.0, max(0.0, share))

    def fail(self, error: str, findings: Sequence[Finding] = (), goes_on: bool = False) -> None:
        """End the job with an error; with ``goes_on`` it can be resumed."""
        self.state, self.order, self.ended, self.goes_on = "failed", None, time.monotonic(), goes_on
        self.error = error[:MAX_LINE]
        self.findings = bounded(findings)

    def resume(self) -> None:
        """Queue the refused job once more, because the client insists."""
        self.state, self.ended, self.goes_on, self.error, self.findings = "waiting", None, False, "", ()

    def done(self, notes: Sequence[Finding] = ()) -> None:
        """End the job with success."""
        self.state, self.share, self.ended = "done", 1.0, time.monotonic()
        self.notes = bounded(notes)

    def status(self, ahead: int) -> dict[str, Any]:
        """Return the JSON object for clients; ``ahead`` is the number of jobs before this one."""
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
    """Return the guesses recorded in an avatar's metadata; none if they are recorded in another way."""
    guessed = meta.get("guessed")
    found = [each for each in guessed if isinstance(each, Mapping)] if isinstance(guessed, (list, tuple)) else []
    return tuple((str(one.get("side")), str(one.get("code")), str(one.get("text"))) for one in found)


def bounded(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return at most MAX_STEPS findings with texts of at most MAX_LINE characters."""
    return tuple((side[:MAX_LINE], code[:MAX_LINE], text[:MAX_LINE]) for side, code, text in findings[:MAX_STEPS])
