"""The process that makes one avatar. It returns JSON and a .glb file, nothing executable.

It decodes untrusted files, so it shares nothing with the server and may crash, hang or be killed at any time. It
writes no file; the pictures are only in its memory.
"""

from __future__ import annotations

import io
import json
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

import msgspec

from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError
from glsplat.extras.uploads.job import (
    MAX_LINE,
    Finding,
    LowConfidenceError,
    Make,
    Order,
    Progress,
    UploadConfig,
    bounded,
)
from glsplat.formats import save

MAX_MESSAGE_BYTES = 1 << 19  # bounded findings, each character escaped to at most twelve bytes
PROGRESS_INTERVAL_S = 0.1  # between two messages about the same step
_CANCELLED, _TIMED_OUT = "cancelled", "timed out"
_RESUME = "go on"
_OOM_SCORE = "1000"  # when memory runs out, Linux kills this process first


class UploadCancelledError(Exception):
    """The client cancelled its upload, or the server stops."""


class MakerFaultError(Exception):
    """The process ended unexpectedly. The message is for the log and holds nothing that a client sent."""


class _Message(msgspec.Struct):
    """One line of JSON from the process; ``kind`` is ready, step, refused, failed, avatar or fault."""

    kind: str
    step: str = ""
    share: float = 0.0
    error: str = ""
    findings: list[Finding] = []
    waits: bool = False


class Maker:
    """Makes one avatar in its own process, which has ended when ``make`` or ``go_on`` returns or raises.

    Only while ``waits`` is true, the process holds refused pictures; ``go_on`` makes an avatar of them, ``close`` ends
    the process.
    """

    def __init__(self, config: UploadConfig) -> None:
        self._config = config
        self._process: SpawnProcess | None = None
        self._pipe: Connection | None = None
        self._kill_reason = ""
        self._lock = threading.Lock()
        self.waits: bool = False
        """Whether ``go_on`` may be called."""

    def make(self, order: Order, progress: Progress) -> bytes:
        """Return a .glb file made from ``order``; ``progress`` is called on this thread.

        Raises LowConfidenceError and GlsplatError of ``config.make``, GlsplatError on a timeout, MakerFaultError, and
        UploadCancelledError after ``stop``.
        """
        spawn = multiprocessing.get_context("spawn")
        self._pipe, theirs = spawn.Pipe()
        process = spawn.Process(
            target=_work, args=(self._config.make, self._config.nice, theirs), name="glsplat maker", daemon=True
        )
        try:
            with self._lock:
                if self._kill_reason:
                    raise UploadCancelledError
                process.start()
                self._process = process
        except BaseException:
            self.close()
            raise
        finally:
            theirs.close()
        return self._result(self._pipe, process, order, progress)

    def go_on(self, progress: Progress) -> bytes:
        """Resume the waiting process; return and raise as ``make``."""
        pipe, process = self._pipe, self._process
        if not self.waits or pipe is None or process is None:
            raise UploadCancelledError
        self.waits = False
        return self._result(pipe, process, None, progress)

    def close(self) -> None:
        """Kill the process, if there is one. May be called twice."""
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
        """Cancel the work. Safe on any thread at any time."""
        self._kill(_CANCELLED)

    def _kill(self, reason: str) -> None:
        with self._lock:
            self._kill_reason = self._kill_reason or reason
            if self._process is not None:
                self._process.kill()

    def _result(self, pipe: Connection, process: SpawnProcess, order: Order | None, progress: Progress) -> bytes:
        """Exchange messages until the process returns, within ``config.make_timeout``."""
        timer = threading.Timer(self._config.make_timeout, self._kill, (_TIMED_OUT,))
        timer.start()
        try:
            return self._exchange(pipe, order, progress)
        except (EOFError, OSError):  # the process ended, or sent more than MAX_MESSAGE_BYTES
            if self._kill_reason == _CANCELLED:
                raise UploadCancelledError from None
            if self._kill_reason == _TIMED_OUT:
                limit = self._config.make_timeout
                raise GlsplatError(f"it took more than {limit:g} s and was given up; try again later") from None
            raise MakerFaultError(f"its process ended{_exit_status(process)}") from None
        finally:
            timer.cancel()
            if not self.waits:
                self.close()

    def _exchange(self, pipe: Connection, order: Order | None, progress: Progress) -> bytes:
        if order is None:
            pipe.send(_RESUME)
        while True:
            try:
                message = msgspec.json.decode(pipe.recv_bytes(MAX_MESSAGE_BYTES), type=_Message)
            except (msgspec.MsgspecError, UnicodeDecodeError):
                raise MakerFaultError("its process sent a message that cannot be read") from None
            match message.kind:
                case "ready":
                    pipe.send(order)
                case "step":
                    progress(message.step, message.share)
                case "refused":
                    self.waits = message.waits and not self._kill_reason
                    raise LowConfidenceError(message.error, message.findings)
                case "failed":
                    raise GlsplatError(message.error)
                case "avatar":
                    return pipe.recv_bytes(self._config.avatar_bytes)
                case _:
                    raise MakerFaultError(message.error[:200])


def _exit_status(process: SpawnProcess) -> str:
    if process.pid is None:
        return " before it began"
    process.join(1.0)
    code = process.exitcode
    return "" if code is None else f" with signal {-code}" if code < 0 else f" with code {code}"


def _work(make: Make, nice: int, pipe: Connection) -> None:
    """Run the process: make an avatar and send messages about it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process of a terminal; the server ends this one
    _silence_output()
    _lower_priority(nice)
    last_step, last_sent = "", 0.0

    def send(kind: str, **fields: Any) -> None:
        pipe.send_bytes(json.dumps({"kind": kind, **fields}).encode())

    def progress(step: str, share: float) -> None:
        nonlocal last_step, last_sent
        now = time.monotonic()
        if step != last_step or share >= 1 or now - last_sent > PROGRESS_INTERVAL_S:
            last_step, last_sent = step, now
            send("step", step=step[:MAX_LINE], share=float(share))

    with suppress(OSError):  # the server is gone
        try:
            send("ready")
            order = pipe.recv()
            next_try: Callable[[], Avatar] | None = partial(make, order, progress)
            while next_try is not None:
                try:
                    avatar = next_try()
                except OSError as error:  # a missing file or a full disk, not the pipe
                    send("fault", error=f"OSError{_location(error)}")
                    return
                except LowConfidenceError as error:
                    next_try = error.go_on
                    waits = next_try is not None
                    send("refused", error=_one_line(error), findings=bounded(error.findings), waits=waits)
                    if waits:
                        pipe.recv()  # _RESUME, or the server kills this process
                    continue
                data = io.BytesIO()
                save(avatar, data, format="glb")
                send("avatar")
                pipe.send_bytes(data.getbuffer())
                break
        except GlsplatError as error:
            send("failed", error=_one_line(error))
        except (OSError, EOFError):  # the pipe is closed
            return
        except BaseException as error:  # also MemoryError and SystemExit
            send("fault", error=f"{type(error).__name__}{_location(error)}")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:MAX_LINE]


def _location(error: BaseException) -> str:
    """Return " at FILE:LINE" of an error without its message, which may hold data of the picture."""
    trace, location = error.__traceback__, ""
    while trace is not None:
        location = f" at {trace.tb_frame.f_code.co_filename.rpartition('/')[2]}:{trace.tb_lineno}"
        trace = trace.tb_next
    return location


def _silence_output() -> None:
    """Discard output: libraries print parts of the pictures that they decode, which must not reach the log."""
    devnull = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(devnull, descriptor)
    os.close(devnull)


def _lower_priority(nice: int) -> None:
    """Give drawing and serving the CPU and the memory first."""
    with suppress(OSError, AttributeError):
        os.nice(nice)
    with suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
        file.write(_OOM_SCORE)
