"""The UDP port at which a face comes in: on this machine's own address, and on no other."""

from __future__ import annotations

import logging
import socket
import threading
import time
from types import TracebackType
from typing import Self

from glsplat.errors import GlsplatError
from glsplat.extras.speech.face.feed import FaceFeed

__all__ = ["FaceListener"]

log: logging.Logger = logging.getLogger("glsplat.net")

_HOST = "127.0.0.1"
_LARGEST = 16384  # bytes of a packet that are read; VRCFaceTracking's bundles have 4096
_AGAIN = 0.2  # seconds after an error of the system's, which may last
_BUSY, _PAUSE = 0.005, 3.0  # seconds of work in a row, after which so many times as much is rest: a flood takes no core


class FaceListener:
    """``with FaceListener(feed, 9000):`` listens in a thread of its own. Port 0: any free one.

    Raises GlsplatError where the port is taken.
    """

    def __init__(self, feed: FaceFeed, port: int) -> None:
        self.feed = feed
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((_HOST, port))
        except OSError as error:
            self._socket.close()
            raise GlsplatError(f"UDP port {port} cannot be listened at ({error.strerror}); choose another") from None
        self._socket.settimeout(0.2)
        self.port: int = self._socket.getsockname()[1]
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="face", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ends.set()
        self._thread.join()
        self._socket.close()

    def _listen(self) -> None:
        busy, failing = 0.0, False
        while not self._ends.is_set():
            before = time.perf_counter()
            try:
                packet = self._socket.recv(_LARGEST)
            except TimeoutError:
                continue
            except OSError as error:  # of one packet: a sender that is gone, where the system says so
                if not failing:
                    log.warning("the port of the face cannot be read just now (%s); it is tried again", error.strerror)
                failing = True
                self._ends.wait(_AGAIN)
                continue
            failing = False
            came, worked = time.perf_counter(), time.thread_time()
            self.feed.heard(packet, came)
            busy = max(0.0, busy - (came - before) / _PAUSE) + time.thread_time() - worked
            if busy > _BUSY:
                self._ends.wait(_PAUSE * busy)
                busy = 0.0
