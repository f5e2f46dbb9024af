"""Scripted tracking for Monado's "remote" driver: one TCP socket, a message of 376 bytes (r_interface.h, 25.0)."""

from __future__ import annotations

import socket
import struct
import threading
import time
from dataclasses import dataclass

Vec = tuple[float, float, float]
Quat = tuple[float, float, float, float]  # xyzw


@dataclass(frozen=True)
class Script:
    """Values for Monado; angles in radians (left, right, up, down), eyes in the head's axes."""

    head: tuple[Quat, Vec] = ((0.0, 0.0, 0.0, 1.0), (0.0, 1.6, 0.0))
    fovs: tuple[tuple[float, float, float, float], ...] = ((-0.94, 0.7, 0.73, -0.96), (-0.7, 0.94, 0.73, -0.96))
    eyes: tuple[Vec, Vec] = ((-0.0315, 0.0, 0.0), (0.0315, 0.0, 0.0))
    hands: tuple[tuple[Quat, Vec], ...] = (((0.0, 0.0, 0.0, 1.0), (-0.25, 1.2, -0.4)),) * 2
    curls: tuple[tuple[float, ...], ...] = ((0.0,) * 5,) * 2

    def message(self) -> bytes:
        eyes = b"".join(
            struct.pack("<4f", *fov) + _pose((0, 0, 0, 1), eye) + struct.pack("<I", 0)
            for fov, eye in zip(self.fovs, self.eyes, strict=True)
        )
        head = eyes + _pose(*self.head) + bytes([1, 0, 0, 0])
        hands = b"".join(
            _pose(*hand) + bytes(24) + struct.pack("<5f", *curls) + bytes(32) + bytes([1, 1]) + bytes(14)
            for hand, curls in zip(self.hands, self.curls, strict=True)
        )
        out = b"mndrmt3\0" + head + hands
        assert len(out) == 376
        return out


def _pose(quat: Quat, place: Vec) -> bytes:
    return struct.pack("<7f", *quat, *place)


class Sender:
    """Sends the script 90 times per second; reconnects when the service restarts."""

    def __init__(self, port: int = 4242) -> None:
        self.script = Script()
        self._port, self._over = port, threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._over.is_set():
            try:
                with socket.create_connection(("127.0.0.1", self._port), timeout=2) as link:
                    while not self._over.wait(1 / 90):
                        link.sendall(self.script.message())
            except OSError:
                time.sleep(0.1)
