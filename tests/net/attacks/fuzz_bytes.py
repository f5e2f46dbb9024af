"""Raw byte streams at the real port of a real server.

A stream is HTTP that was once a request, or a handshake followed by WebSocket frames that were once a session, both
changed at random. The server has to stay up, answer others in time, and leave no traceback in its log.
"""

from __future__ import annotations

import socket
import struct
import time
from collections import Counter, deque
from dataclasses import dataclass, field
from random import Random

from tests.net.attacks.fuzz_messages import message
from tests.net.attacks.requests import request
from tests.net.attacks.sockets import Target, abort, connect, frame, handshake
from tests.net.attacks.victim import Victim

__all__ = ["Sent", "send", "stream"]

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
BITS = [0, 1, 0x7D, 0x7E, 0x7F, 0x80, 0x81, 0x88, 0x89, 0x8A, 0xFE, 0xFF, 0x0A, 0x0D, 0x20, 0x3A]
PARTS = [
    b"\r\n",
    b"\r\n\r\n",
    b"\n",
    b"\r",
    b" ",
    b":",
    b"\t",
    b"\0",
    b"HTTP/1.1",
    b"GET ",
    b"\x80",
    b"%00",
    b"a" * 9000,
]
LINES = b"""Host: a|Content-Length: 5|Content-Length: 99999999999999999999|Transfer-Encoding: chunked|Connection: close
Expect: 100-continue|Upgrade: h2c|Origin: null|Cookie: |Sec-WebSocket-Version: 99|Sec-WebSocket-Key: short
Sec-WebSocket-Extensions: permessage-deflate; server_max_window_bits=99|Sec-WebSocket-Protocol: ,,,
Authorization: Basic ===="""
PARTS += [line + b"\r\n" for line in LINES.replace(b"\n", b"|").split(b"|")]
PATHS = "/ws / /stats /metrics /healthz /ws?window=9 /ws?height=nan /ws?mirror=%ff /ws?avatar=%00&span=nan /vr".split()
PATHS += "/vr/index.html /vr/%2e%2e/stats /session /motions/idle // /../x *".split()

HELD = 32  # connections that are open at once


@dataclass
class Sent:
    """What was sent and what the server made of it."""

    streams: int = 0
    answers: Counter[str] = field(default_factory=Counter)  # first bytes of what came back
    probes: list[float] = field(default_factory=list)  # seconds that /healthz took meanwhile
    faults: list[int] = field(default_factory=list)  # streams that were answered with a fault of the server's own
    dead: bool = False
    seconds: float = 0.0


def stream(i: int, chance: Random, target: Target) -> list[bytes]:
    """The i-th stream, in the pieces it is sent in."""
    kind = chance.random()
    if kind < 0.4:
        method = chance.choice(("GET", "GET", "POST", "HEAD", "OPTIONS", "PUT", "get", "\xff"))
        head = f"{method} {chance.choice(PATHS)} HTTP/1.{chance.choice('0119')}\r\nHost: {target.host}\r\n\r\n"
        data = bent(chance.choice((head.encode("latin-1"), handshake(target))), chance)
    elif kind < 0.5:
        data = bent(chance.choice(GARBAGE), chance)
    elif kind < 0.55:
        data = chance.randbytes(chance.randint(0, 3000))
    else:
        session = [frame(0x1, request(1, (16, 16)))]
        for _ in range(chance.randint(1, 5)):
            session.append(frames(i, chance))
        data = handshake(target, chance.choice(("", "?window=8", "?mirror=1"))) + b"".join(session)
    cuts = sorted(chance.randint(0, len(data)) for _ in range(chance.choice((0, 0, 0, 1, 2))))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


def frames(i: int, chance: Random) -> bytes:
    """One or more frames, some of them broken."""
    text = message(i, chance)
    payload = (text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text)[:66_000]
    match chance.randrange(8):
        case 0:
            return chance.choice(BROKEN)
        case 1:
            return bent(frame(0x1, payload[:2000]), chance)
        case 2:
            at = chance.randint(0, len(payload))
            return frame(0x1, payload[:at], fin=False) + frame(0x9, b"x") + frame(0x0, payload[at:])
        case 3:
            return frame(
                chance.randrange(16), payload[: chance.choice((0, 1, 2, 125, 126, 2000))], chance.random() < 0.7
            )
        case 4:
            head = bytes((chance.choice(BITS), 0x80 | chance.randrange(128)))
            return head + struct.pack("!Q", chance.getrandbits(64)) + chance.randbytes(8)
        case 5:
            return frame(0x8, struct.pack("!H", chance.choice((0, 999, 1000, 1005, 1006, 1015, 2999, 5000))) + b"bye")
        case _:
            return frame(0x1, payload)


def bent(data: bytes, chance: Random) -> bytes:
    """Some bytes changed, put in, taken out or doubled."""
    out = bytearray(data)
    for _ in range(chance.choice((0, 1, 1, 2, 4, 16))):
        at = chance.randint(0, len(out))
        match chance.randrange(5):
            case 0 if at < len(out):
                out[at] = chance.choice(BITS)
            case 1:
                out[at:at] = chance.choice(PARTS)
            case 2:
                del out[at : at + chance.randint(1, 20)]
            case 3:
                out[at:at] = out[at : at + 40]
            case _ if at < len(out):
                out[at] ^= 1 << chance.randrange(8)
    return bytes(out)


def send(server: Victim, number: int, seed: int, addresses: int = 200) -> Sent:
    """``number`` streams from as many loopback addresses as told, with a look at /healthz now and then."""
    sent, start = Sent(), time.monotonic()
    held: deque[tuple[int, socket.socket, Random]] = deque()  # sent, and to be read when the server had its time

    def count(i: int, answer: str) -> None:
        sent.streams += 1
        sent.answers[answer] += 1
        if answer[8:] == " 500":
            sent.faults.append(i)

    for i in range(number):
        chance = Random(seed * 1_000_003 + i)
        target = server.target.to(f"127.0.{1 + i % addresses // 200}.{1 + i % 200}")
        begun = begin(target, stream(i, chance, target), chance)
        if isinstance(begun, str):
            count(i, begun)
        else:
            held.append((i, begun, chance))
        if len(held) > HELD:
            first, *answering = held.popleft()
            count(first, finish(*answering))
        if i % 50 == 0:
            began = time.monotonic()
            if server.get("/healthz") != "ok\n" and server.process.poll() is not None:
                sent.dead = True
                break
            sent.probes.append(time.monotonic() - began)
    for i, *answering in held:
        count(i, finish(*answering))
    sent.seconds = time.monotonic() - start
    return sent


def begin(target: Target, pieces: list[bytes], chance: Random) -> socket.socket | str:
    """Send one stream; its connection, or why there is none to be read."""
    try:
        sock = connect(target)
    except OSError as error:
        return f"cannot connect ({type(error).__name__})"
    try:
        for piece in pieces:
            sock.sendall(piece)
        if chance.random() < 0.5:
            sock.shutdown(socket.SHUT_WR)
    except OSError:
        sock.close()
        return "(reset while sending)"
    return sock


def finish(sock: socket.socket, chance: Random) -> str:
    """How the server's answer began; now and then without a farewell."""
    sock.settimeout(0.02)
    try:
        answer = sock.recv(4096)[:12].decode("latin-1") or "(end)"
    except TimeoutError:
        answer = "(waits)"
    except OSError:
        answer = "(reset)"
    if chance.random() < 0.2:
        abort(sock)
    sock.close()
    return answer
