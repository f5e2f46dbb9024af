"""Attackers that never become clients: connections, HTTP, tokens."""

from __future__ import annotations

import base64
import random
import socket
import threading

from tests.net.attacks.requests import request
from tests.net.attacks.sockets import (
    CHEAP,
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


def idle_clients(target: Target, number: int, stop: threading.Event) -> None:
    """A WebSocket that never asks for anything takes a client's place."""
    with upgrade(target) as sock:
        while not stop.wait(0.2):
            drain(sock)


def held_places(target: Target, number: int, stop: threading.Event) -> None:
    """Asks for one speck of a picture, then says just enough to be let alone: a client's place for nothing."""
    with upgrade(target, "?window=1") as sock:
        sock.sendall(frame(0x1, request(1, (1, 1))))
        while not stop.wait(0.5):
            sock.sendall(frame(0x1, b'{"v":1,"ack":0}'))
            drain(sock)


def slow_loris(target: Target, number: int, stop: threading.Event) -> None:
    """Ten handshakes at once, one byte of each every 0.2 s."""
    held = [connect(target) for _ in range(10)]
    try:
        for byte in handshake(target, headers="X-Filling: " + "a" * 4000 + "\r\n"):
            for sock in held:
                sock.sendall(bytes((byte,)))
            if stop.wait(0.2):
                return
    finally:
        for sock in held:
            sock.close()


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


def header_bomb(target: Target, number: int, stop: threading.Event) -> None:
    """Headers as long and as many as the parser takes, then longer."""
    bombs = [
        "X-Long: " + "A" * 6000 + "\r\n",
        "X-Long: " + "A" * 60_000 + "\r\n",
        "".join(f"X-{i}: {i}\r\n" for i in range(2000)),
        "Sec-WebSocket-Protocol: " + "token.SECRETSECRETSECRET," * 250 + "\r\n",
        "Cookie: " + "a=b;" * 1500 + "\r\n",
    ]
    while not stop.is_set():
        for bomb in bombs:
            try:
                upgrade(target, headers=bomb).close()
            except OSError:
                pass
            stop.wait(0.02)


GARBAGE = [
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(range(256)),  # TLS to a plain port
    b"GET /\r\n\r\n",
    b"GET / HTTP/9.9\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\nContent-Length: -1\r\n\r\n",
    b"POST /ws HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\nZZ\r\n",
    b"\0" * 500,
    b"GET /" + b"%ff" * 2000 + b" HTTP/1.1\r\nHost: a\r\n\r\n",
    b"GET /ws HTTP/1.1\r\nHost: [::1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\r\n",
    b"GET http://[ HTTP/1.1\r\nHost: x\r\n\r\n",
    b"CONNECT a:1 HTTP/1.1\r\nHost: a\r\n\r\n",
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
]


def malformed(target: Target, number: int, stop: threading.Event) -> None:
    """What is no HTTP, 50 times a second."""
    i = number
    while not stop.wait(0.02):
        with connect(target) as sock:
            sock.sendall(GARBAGE[i % len(GARBAGE)])
            i += 1


def pages(target: Target, number: int, stop: threading.Event) -> None:
    """/stats, /metrics, / and what is not there, ten at once on one connection, 400 a second."""
    paths = ["/stats", "/metrics", "/", "/healthz", "/nothing"] * 2
    blob = "".join(f"GET {path} HTTP/1.1\r\nHost: {target.host}:{target.port}\r\n\r\n" for path in paths).encode()
    with connect(target) as sock:
        repeat(sock, lambda: blob, 40, stop)


def unread_pages(target: Target, number: int, stop: threading.Event) -> None:
    """Page after page asked for on one connection and never taken: who keeps the requests, or the answers?"""
    blob = f"GET /metrics HTTP/1.1\r\nHost: {target.host}:{target.port}\r\n\r\n".encode() * 500
    with connect(target, receive_buffer=4096) as sock:
        repeat(sock, lambda: blob, 40, stop, read=False)


def body(target: Target, number: int, stop: threading.Event) -> None:
    """A request whose body never ends, in chunks of one byte."""
    head = f"POST / HTTP/1.1\r\nHost: {target.host}:{target.port}\r\nTransfer-Encoding: chunked\r\n\r\n"
    with connect(target) as sock:
        sock.sendall(head.encode())
        repeat(sock, lambda: b"1\r\nx\r\n" * 1000, 50, stop)


BROKEN = [
    b"\x81\x05hello",  # not masked
    frame(0x1, b"{}")[:1].replace(b"\x81", b"\xf1") + frame(0x1, b"{}")[1:],  # reserved bits
    frame(0x3, b"no such opcode"),
    frame(0x9, b"a ping of more than 125 bytes" * 10),
    frame(0x0, b"a continuation of nothing"),
    frame(0x1, b"\xff\xfe not UTF-8"),
    b"\x81\xff" + b"\x7f" + b"\xff" * 7 + b"\0\0\0\0" + b"x" * 100_000,  # 2^63 bytes are to come
    frame(0x1, b" " * 70_000),
    frame(0x8, b"\x00"),
    frame(0x8, b"\x03\xe8" + b"x" * 200),
]


def broken_frames(target: Target, number: int, stop: threading.Event) -> None:
    """A handshake and then a frame that breaks RFC 6455, 30 times a second."""
    i = number
    while not stop.wait(0.03):
        with upgrade(target) as sock:
            sock.sendall(BROKEN[i % len(BROKEN)])
            i += 1


def uninvited(target: Target, number: int, stop: threading.Event) -> None:
    """Hellos of QUIC and garbage to the UDP port, as fast as they go."""
    hello = b"\xc0\0\0\0\1\x08" + random.randbytes(8) + b"\0\0\x44\0" + random.randbytes(1182)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind((target.source, 0))
        while not stop.wait(CHEAP):
            for _ in range(100):
                sock.sendto(hello, (target.host, target.port))
                sock.sendto(random.randbytes(40), (target.host, target.port))


HANDSHAKES: dict[str, Attack] = {
    "idle connections": again_and_again(idle),
    "clients that ask for nothing": again_and_again(idle_clients),
    "clients that hold their place": again_and_again(held_places),
    "slow handshakes": again_and_again(slow_loris),
    "connections that end at once": again_and_again(churn),
    "clients that end at once": again_and_again(client_churn),
    "handshake and reset": again_and_again(reset),
    "guessed tokens": again_and_again(guesses),
    "long headers": again_and_again(header_bomb),
    "no HTTP": again_and_again(malformed),
    "status pages": again_and_again(pages),
    "status pages, unread": again_and_again(unread_pages),
    "a body without end": again_and_again(body),
    "broken frames": again_and_again(broken_frames),
    "datagrams of strangers": again_and_again(uninvited),
}
