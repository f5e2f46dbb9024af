"""Fitting pictures to links over real sockets and in sessions."""

from __future__ import annotations

import json

import aiohttp
import numpy as np
import pytest

from glsplat.errors import ProtocolError
from glsplat.extras.far_links.link_control import LinkControl
from glsplat.net.client import Client
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import Ack, Decoder, Request
from glsplat.net.pace.ladder import ladder
from glsplat.net.reply import parse_reply
from glsplat.net.server import ServerConfig
from glsplat.net.session import Session, SessionConfig, Warn
from glsplat.net.wire_schema import Arrival
from tests.net.wire import EYE, HANG


def said(**fields) -> bytes:
    return json.dumps({"v": 1, **fields}).encode()


def asking(number: int, **fields) -> bytes:
    return said(frame_id=number, eyes=[EYE, EYE], size=[64, 64], **fields)


ADAPTS = ServerConfig(port=0, session=SessionConfig(adapt=True))


def test_an_arrival_is_read() -> None:
    decoder, arrival = Decoder(), {"age": 87.5, "held": 0.5}
    assert decoder.decode(said(ack=7, arrival=arrival)) == Ack(7, Arrival(87.5, 0.5))
    assert decoder.decode(asking(8, ack=7, arrival={"age": 1})).arrival == Arrival(1.0, 0.0)
    assert decoder.decode(asking(8, ack=7)).arrival is None
    assert decoder.decode(asking(8, ack=7, arrival=None)).arrival is None


@pytest.mark.parametrize(
    "arrival",
    [
        *({"age": age} for age in (-1, 60_001, "1", True, None)),
        *({"age": 1, "held": held} for held in (-0.1, 1e9)),
        *({"held": 1}, {}, [], "soon"),
    ],
)
def test_what_is_no_arrival_is_refused(arrival) -> None:
    with pytest.raises(ProtocolError) as caught:
        Decoder().decode(said(ack=7, arrival=arrival))
    assert caught.value.code in ("bad_request", "bad_field")
    with pytest.raises(ProtocolError, match="arrival needs ack"):
        Decoder().decode(asking(8, arrival={"age": 1}))


def opened(**config) -> Session:
    return Session(Decoder(), SessionConfig(**{"adapt": True} | config), now=0.0)


def test_fitting_begins_with_the_first_arrival() -> None:
    session = opened()
    assert session.receive(asking(1, ack=0), 0.1) is not None and session.link is None and session.window == 2
    assert session.receive(asking(2, ack=0, arrival={"age": 50}), 0.2) is not None
    assert session.link is not None and session.window == 2  # until something is known of it: not eight large ones
    link, now = session.link, 1.0
    link.ponged(link.ping(now) or b"", now + 0.02)
    link.written(1, 10_000, now + 0.1)
    assert session.link.link.known is False
    link.acknowledged(1, 0.1, 0.0, now + 0.2)
    assert session.window == 8


@pytest.mark.parametrize("acknowledges", [True, False])
def test_who_stops_saying_it_goes_on_getting_pictures(acknowledges: bool) -> None:
    session, now, drawn = opened(), 0.0, 0
    for number in range(1, 121):
        now += 0.033
        says = number <= 40
        more = {"ack": drawn} if says or acknowledges else {}
        more |= {"arrival": {"age": 40}} if says and drawn else {}
        assert isinstance(session.receive(asking(number, **more), now), Request)
        if session.link is not None:
            session.link.ponged(session.link.ping(now) or b"", now + 0.005)
        if session.ready() and session.rest(now) <= 0:
            taken = session.next_request(now)
            assert taken is not None
            session.rung(taken[0], now)
            session.sending(taken[0], 20_000, now + 0.01)
            session.sent(taken[0], 20_000)
            drawn = taken[0].frame_id
    assert drawn >= 115


def test_servers_that_do_not_adapt_ignore_it_and_named_windows_are_kept() -> None:
    fixed, named = opened(adapt=False), opened(window=3, max_window=3)
    for session in (fixed, named):
        assert session.receive(asking(1, ack=0, arrival={"age": 50}), 0.1) is not None
    assert fixed.link is None and fixed.window == 2 and fixed.rest(0.2) == 0 and named.window == 3


def test_a_lie_about_what_was_never_sent_is_an_error() -> None:
    session = opened()
    answer = session.receive(said(ack=99, arrival={"age": 0}), 0.1)
    assert isinstance(answer, Warn) and "bad_ack" in answer.text and session.link is None


async def pictures_of(server, tells: bool = False) -> list[bytes]:
    """Replies, without what no two have alike."""
    out = []
    async with aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
        for number in range(1, 6):
            told = {"arrival": {"age": 5_000, "held": 0}} if tells and number > 1 else {}
            await ws.send_str(asking(number, ack=number - 1, t=None, **told).decode())
            reply = parse_reply((await ws.receive(timeout=HANG)).data)
            assert "detail" not in reply.info and reply.info["crop"] is None
            out.append(b"".join(reply.pictures.values()))
    return out


async def test_who_says_nothing_and_fixed_get_the_same_bytes(serve, fake_backend) -> None:
    async with serve(fake_backend(), ADAPTS) as server:
        silent = await pictures_of(server)
    async with serve(fake_backend()) as server:
        fixed, told = await pictures_of(server), await pictures_of(server, tells=True)
    assert silent == fixed == told and len(silent) == 5


async def test_a_thin_link_brings_smaller_pictures_that_can_be_read(serve, fake_backend, monkeypatch, cameras) -> None:
    small = next(rung for rung in ladder(80, False) if rung.scale == 0.5)
    monkeypatch.setattr(LinkControl, "rung", lambda *_: small)
    async with serve(fake_backend(), ADAPTS) as server, Client(server.url, adapt=True) as client:
        first = await client.render(cameras, crop=False)
        second, stats = await client.render(cameras, crop=False), server.stats()
    assert "detail" not in first.info  # nothing had arrived yet
    assert second.info["size"] == [32, 32] and second.info["detail"]["why"] == "link"
    assert second.info["detail"]["quality"] == small.quality and second.info["crop"]
    assert [image.shape for image in second.images()] == [(32, 32, 3)] * 2
    assert np.isclose(second.info["eyes"][0]["K"][0], first.info["eyes"][0]["K"][0] / 2)
    assert stats["clients"][0]["link"]["round_trip"] is not None


async def test_a_ping_follows_each_picture_and_its_pong_costs_the_client_nothing(serve, fake_backend) -> None:
    """Pongs of pictures do not count as the client's own control frames."""
    quick = ServerConfig(port=0, session=SessionConfig(adapt=True, rate=1e6))  # as the machine may be
    async with serve(fake_backend(), quick) as server, aiohttp.ClientSession() as http:
        async with http.ws_connect(server.url, autoping=False) as ws:
            kinds, payloads, told = [], set(), {}
            await ws.send_str(asking(1, ack=0).decode())
            number = 1
            while number <= 300:
                message = await ws.receive(timeout=HANG)
                kinds.append(message.type)
                if message.type == aiohttp.WSMsgType.PING:
                    payloads.add(bytes(message.data))
                    await ws.pong(message.data)
                else:
                    assert message.type == aiohttp.WSMsgType.BINARY, message
                    assert "detail" not in parse_reply(message.data).info
                    told = {"arrival": {"age": 5, "held": 0}}
                    number += 1
                    await ws.send_str(asking(number, ack=number - 1, **told).decode())
            client = server.stats()["clients"][0]
    assert len(payloads) >= 299 > Limits().control_burst
    behind = [kinds[i + 1] for i, kind in enumerate(kinds[:-1]) if kind == aiohttp.WSMsgType.BINARY]
    assert behind[2:] == [aiohttp.WSMsgType.PING] * len(behind[2:])
    assert client["link"]["rate"] > 0 and client["limited"] == 0


async def test_pings_of_clients_are_still_answered(serve) -> None:
    async with serve() as server, aiohttp.ClientSession() as http:
        async with http.ws_connect(server.url, autoping=False) as ws:
            await ws.ping(b"there?")
            message = await ws.receive(timeout=HANG)
            assert (message.type, bytes(message.data)) == (aiohttp.WSMsgType.PONG, b"there?")
