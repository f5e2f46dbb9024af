"""The process that makes one avatar. What comes back from it is JSON and a .glb file, nothing that could be executed.

It decodes files of strangers, so it has nothing of the server's, and it may crash, hang or be killed at any time: it
writes no file, and the pictures are in its memory alone.
"""

from __future__ import annotations

import io
import json
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError
from glsplat.extras.uploads.job import WORDS, Finding, LowConfidenceError, Make, Order, Progress, UploadConfig, bounded
from glsplat.formats import save

__all__ = ["Maker", "MakerFaultError", "UnwantedError"]

_LINE = 1 << 19  # bytes of what the process tells at once: of bounded findings, each character written as twelve
_TELL = 0.1  # seconds between two lines about the same step
_CANCELLED, _LATE = "cancelled", "late"
_GO_ON = "go on"
_BEFORE_OTHERS = "1000"  # where memory runs out, the system ends this process first


class UnwantedError(Exception):
    """Nobody wants it any more."""


class MakerFaultError(Exception):
    """The process ended otherwise than it should: for the log, without anything that a client sent."""


class Maker:
    """Makes one avatar in a process of its own, which has ended when ``make`` or ``go_on`` returns or raises.

    Unless it then ``waits``: refused pictures are made an avatar of by ``go_on`` all the same, or ``close`` ends it.
    """

    def __init__(self, config: UploadConfig) -> None:
        self._config = config
        self._process: SpawnProcess | None = None
        self._pipe: Connection | None = None
        self._ended = ""  # why the process was ended from here
        self._lock = threading.Lock()
        self.waits: bool = False
        """Whether ``go_on`` may be called."""

    def make(self, order: Order, progress: Progress) -> bytes:
        """A .glb file made of ``order``; ``progress`` is called on this thread.

        Raises what ``config.make`` raises on purpose, GlsplatError when it takes too long, MakerFaultError, and
        UnwantedError after ``stop``.
        """
        spawn = multiprocessing.get_context("spawn")
        self._pipe, theirs = spawn.Pipe()
        process = spawn.Process(
            target=_work, args=(self._config.make, self._config.nice, theirs), name="glsplat maker", daemon=True
        )
        try:
            with self._lock:
                if self._ended:
                    raise UnwantedError
                process.start()
                self._process = process
        except BaseException:
            self.close()
            raise
        finally:
            theirs.close()
        return self._followed(self._pipe, process, order, progress)

    def go_on(self, progress: Progress) -> bytes:
        """As ``make``, from where its process waits."""
        pipe, process = self._pipe, self._process
        if not self.waits or pipe is None or process is None:
            raise UnwantedError
        self.waits = False
        return self._followed(pipe, process, None, progress)

    def close(self) -> None:
        """End the process, if there is one. Twice is once."""
        with self._lock:
            process, self._process = self._process, None
        self.waits = False
        if process is not None:
            process.kill()
            process.join()
            process.close()
        if self._pipe is not None:
            self._pipe.close()

    def stop(self) -> None:
        """Nobody wants it any more. From any thread, at any time."""
        self._end(_CANCELLED)

    def _end(self, why: str) -> None:
        with self._lock:
            self._ended = self._ended or why
            if self._process is not None:
                self._process.kill()

    def _followed(self, pipe: Connection, process: SpawnProcess, order: Order | None, progress: Progress) -> bytes:
        timer = threading.Timer(self._config.seconds, self._end, (_LATE,))
        timer.start()
        try:
            return self._follow(pipe, order, progress)
        except (EOFError, OSError):  # it is gone, or does not keep to what was agreed
            if self._ended == _CANCELLED:
                raise UnwantedError from None
            if self._ended == _LATE:
                most = self._config.seconds
                raise GlsplatError(f"it took more than {most:g} s and was given up; try again later") from None
            raise MakerFaultError(f"its process ended{_how(process)}") from None
        finally:
            timer.cancel()
            if not self.waits:
                self.close()

    def _follow(self, pipe: Connection, order: Order | None, progress: Progress) -> bytes:
        if order is None:
            pipe.send(_GO_ON)
        while True:
            told = _read(pipe.recv_bytes(_LINE))
            kind = told.get("kind")
            if kind == "ready":
                pipe.send(order)
            elif kind == "step":
                progress(str(told.get("step")), _share(told.get("share")))
            elif kind == "refused":
                self.waits = told.get("waits") is True and not self._ended
                raise LowConfidenceError(str(told.get("error")), _findings(told.get("findings")))
            elif kind == "failed":
                raise GlsplatError(str(told.get("error")))
            elif kind == "avatar":
                return pipe.recv_bytes(self._config.avatar_bytes)
            else:
                raise MakerFaultError(str(told.get("error"))[:200])


def _read(line: bytes) -> dict[str, Any]:
    try:
        told = json.loads(line)
    except ValueError:
        told = None
    return told if isinstance(told, dict) else {"error": "it told what cannot be read"}


def _share(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else 0.0


def _findings(value: object) -> Sequence[Finding]:
    found = value if isinstance(value, list) else []
    return [(str(one[0]), str(one[1]), str(one[2])) for one in found if isinstance(one, list) and len(one) == 3]


def _how(process: SpawnProcess) -> str:
    if process.pid is None:
        return " before it began"
    process.join(1.0)
    code = process.exitcode
    return "" if code is None else f" with signal {-code}" if code < 0 else f" with code {code}"


def _work(make: Make, nice: int, pipe: Connection) -> None:
    """The process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it reaches all processes of a terminal; the server ends this one
    _be_quiet()
    _stand_back(nice)
    last = ("", 0.0)  # the step told last, and when

    def tell(kind: str, **more: Any) -> None:
        pipe.send_bytes(json.dumps({"kind": kind, **more}).encode())

    def progress(step: str, share: float) -> None:
        nonlocal last
        now = time.monotonic()
        if step != last[0] or share >= 1 or now - last[1] > _TELL:
            last = step, now
            tell("step", step=step[:WORDS], share=float(share))

    with suppress(OSError):  # the server is gone
        try:
            tell("ready")
            order = pipe.recv()
            go_on: Callable[[], Avatar] | None = partial(make, order, progress)
            while go_on is not None:
                try:
                    avatar = go_on()
                except OSError as error:  # a file that is missing, a full disk: not the pipe
                    tell("fault", error=f"OSError{_place(error)}")
                    return
                except LowConfidenceError as error:
                    go_on = error.go_on
                    tell("refused", error=_line(error), findings=bounded(error.findings), waits=go_on is not None)
                    if go_on is not None:
                        pipe.recv()  # whoever does not send it ends this process
                    continue
                data = io.BytesIO()
                save(avatar, data, format="glb")
                tell("avatar")
                pipe.send_bytes(data.getbuffer())
                break
        except GlsplatError as error:
            tell("failed", error=_line(error))
        except (OSError, EOFError):  # of the pipe: nobody waits any more
            return
        except BaseException as error:  # also MemoryError, and what libraries end a program with
            tell("fault", error=f"{type(error).__name__}{_place(error)}")


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:WORDS]


def _place(error: BaseException) -> str:
    """Where it happened. Not what: the message may hold something of the picture."""
    trace, place = error.__traceback__, ""
    while trace is not None:
        place = f" at {trace.tb_frame.f_code.co_filename.rpartition('/')[2]}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place


def _be_quiet() -> None:
    """Libraries that decode pictures print what they find in them: that is nothing for the server's log."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(nowhere, descriptor)
    os.close(nowhere)


def _stand_back(nice: int) -> None:
    """Let those who draw and serve go first."""
    with suppress(OSError, AttributeError):
        os.nice(nice)
    with suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
        file.write(_BEFORE_OTHERS)
