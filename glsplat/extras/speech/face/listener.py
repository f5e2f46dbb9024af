"""UDP port for a tracked face, on the loopback address only."""

from __future__ import annotations

import logging
import socket
import threading
import time
from typing import Self

from glsplat.errors import GlsplatError
from glsplat.extras.speech.face.feed import FaceFeed

log: logging.Logger = logging.getLogger("glsplat.net")

_HOST = "127.0.0.1"
MAX_PACKET_BYTES = 16384  # VRCFaceTracking's bundles have 4096
_RETRY_S = 0.2  # after a socket error
_MAX_BUSY_S = 0.005  # of continuous work before a pause ...
_PAUSE_FACTOR = 3.0  # ... of this many times its length, so that a flood does not occupy a core


class FaceListener:
    """``with FaceListener(feed, 9000):`` listens on a thread. Port 0: any free one. Raises GlsplatError."""

    def __init__(self, feed: FaceFeed, port: int) -> None:
        self.feed = feed
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((_HOST, port))
        except OSError as error:
            self._socket.close()
            raise GlsplatError(f"UDP port {port} cannot be opened ({error.strerror}); choose another") from None
        self._socket.settimeout(0.2)
        self.port: int = self._socket.getsockname()[1]
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="face", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()
        self._socket.close()

    def _listen(self) -> None:
        busy, failing = 0.0, False
        while not self._ends.is_set():
            before = time.perf_counter()
            try:
                packet = self._socket.recv(MAX_PACKET_BYTES)
            except TimeoutError:
                continue
            except OSError as error:  # some systems report a closed sender
                if not failing:
                    log.warning("the face-tracking port cannot be read (%s); retrying", error.strerror)
                failing = True
                self._ends.wait(_RETRY_S)
                continue
            failing = False
            received, worked = time.perf_counter(), time.thread_time()
            self.feed.receive(packet, received)
            busy = max(0.0, busy - (received - before) / _PAUSE_FACTOR) + time.thread_time() - worked
            if busy > _MAX_BUSY_S:
                self._ends.wait(_PAUSE_FACTOR * busy)
                busy = 0.0
