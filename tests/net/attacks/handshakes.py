"""Attackers that never become clients: connections, HTTP, tokens."""

from __future__ import annotations

import base64
import random
import threading

from tests.net.attacks.requests import request
from tests.net.attacks.sockets import (
    Attack,
    Target,
    abort,
    again_and_again,
    connect,
    drain,
    frame,
    handshake,
    repeat,
    upgrade,
)

__all__ = ["HANDSHAKES"]

IDLE = 100  # connections a hostile thread holds at once


def idle(target: Target, number: int, stop: threading.Event) -> None:
    """Opens connections and says nothing, until the server has none left to give."""
    held = []
    try:
        while not stop.is_set():
            try:
                if len(held) < IDLE:
                    held.append(connect(target, timeout=0.2))
                else:
                    stop.wait(0.2)
                    held = [sock for sock in held if not gone(sock)]
            except OSError:
                stop.wait(0.1)
    finally:
        for sock in held:
            sock.close()


def gone(sock) -> bool:
    """True, and closed, once the server has ended the connection."""
    try:
        drain(sock)
    except OSError:
        sock.close()
        return True
    return False


def churn(target: Target, number: int, stop: threading.Event) -> None:
    """Connections that end as soon as they are there, 100 a second."""
    while not stop.wait(0.01):
        connect(target).close()


def client_churn(target: Target, number: int, stop: threading.Event) -> None:
    """The same with a handshake, a height to calibrate for and a request: each takes and leaves a client's place."""
    while not stop.wait(0.02):
        with upgrade(target, "?height=1.61") as sock:
            sock.sendall(frame(0x1, request(1, (16, 16))))


def reset(target: Target, number: int, stop: threading.Event) -> None:
    """A handshake followed by a reset, 50 a second."""
    while not stop.wait(0.02):
        sock = connect(target)
        sock.sendall(handshake(target))
        abort(sock)


def guesses(target: Target, number: int, stop: threading.Event) -> None:
    """Tokens tried one after another on connections that stay: headers, subprotocols and passwords."""
    chance = random.Random(number)

    def blob() -> bytes:
        word = "".join(chance.choices("abcdefgh0123456789", k=20))
        basic = base64.b64encode(b"me:" + word.encode()).decode()
        kinds = [
            f"Authorization: Bearer {word}",
            f"Authorization: Basic {basic}",
            f"Sec-WebSocket-Protocol: glsplat.v1, token.{word}",
            f"Sec-WebSocket-Protocol: token.{word}",
        ]
        head = f"GET /stats HTTP/1.1\r\nHost: {target.host}:{target.port}\r\n"
        return "".join(f"{head}{kind}\r\n\r\n" for kind in kinds).encode()

    with connect(target) as sock:
        repeat(sock, blob, 40, stop)


def body(target: Target, number: int, stop: threading.Event) -> None:
    """A request whose body never ends, in chunks of one byte."""
    head = f"POST / HTTP/1.1\r\nHost: {target.host}:{target.port}\r\nTransfer-Encoding: chunked\r\n\r\n"
    with connect(target) as sock:
        sock.sendall(head.encode())
        repeat(sock, lambda: b"1\r\nx\r\n" * 1000, 50, stop)


HANDSHAKES: dict[str, Attack] = {
    "idle connections": again_and_again(idle),
    "connections that end at once": again_and_again(churn),
    "clients that end at once": again_and_again(client_churn),
    "handshake and reset": again_and_again(reset),
    "guessed tokens": again_and_again(guesses),
    "a body without end": again_and_again(body),
}
