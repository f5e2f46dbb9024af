"""SecondWay: sends one client's pictures by datagrams; everything else uses the WebSocket."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from glsplat.extras.far_links.link_control import LinkControl

if TYPE_CHECKING:
    from glsplat.extras.far_links.datagrams.listener import DatagramListener
    from glsplat.extras.far_links.datagrams.path import DatagramPath
    from glsplat.net.session import Session

LONG = 0.008
"""Round trip from which datagrams gain, seconds: TCP waits that long for a lost packet."""
_AGAIN, _LONGER, _TRIES = 15.0, 3.0, 4  # seconds until the next offer, their growth factor, most offers
_GOOD = 200  # pictures from which a path that ended counts as good
_HEARD = 64  # queued messages; older ones are dropped
_WIDEST = 64  # remembered pictures, more than a window has


class SecondWay:
    """One client's datagram path; calls ``wake`` when the next picture may be drawn."""

    def __init__(
        self, listener: DatagramListener, session: Session, address: str, clock: Callable[[], float],
        wake: Callable[[], None],
    ) -> None:  # fmt: skip
        self._listener, self._session, self._address = listener, session, address
        self._clock, self._wake = clock, wake
        self._path: DatagramPath | None = None
        self._next, self._pause, self._tries = 0.0, _AGAIN, 0
        self._sent = self._lost = self._before = 0
        self._newest: deque[int] = deque(maxlen=_WIDEST)  # pictures sent by datagrams
        self._heard: deque[bytes] = deque(maxlen=_HEARD)
        self._more = asyncio.Event()

    def offer(self) -> dict[str, str] | None:
        """Return "datagrams" of the next reply if the client accepts them and its link gains; rarely, else None."""
        link, now = self._link, self._clock()
        if not self._session.datagrams or self._path is not None or link is None or not link.known:
            return None
        if link.link.base < LONG or now < self._next or self._tries >= _TRIES:
            return None
        self._next = now + self._pause
        offer = self._listener.offer(self._address, self)
        if offer is not None:
            self._pause, self._tries = self._pause * _LONGER, self._tries + 1
        return offer

    @property
    def _link(self) -> LinkControl | None:
        link = self._session.link
        assert link is None or isinstance(link, LinkControl)
        return link

    def link_bytes(self, nbytes: int) -> int:
        """Return the bytes on the link of a picture of ``nbytes``, by datagrams or the WebSocket."""
        path = self._path
        return nbytes if path is None or not path.takes(nbytes) else round(nbytes * path.overhead(nbytes))

    def send(self, frame_id: int, picture: bytes) -> bool:
        """Send a picture; return False if it has to use the WebSocket."""
        path, link = self._path, self._link
        if path is None or link is None or not path.takes(len(picture)):
            return False
        self._sent += 1
        self._newest.append(frame_id)
        path.send(frame_id, link.follow(frame_id), picture, link.link.rate)
        return True

    def ping(self, payload: bytes) -> bool:
        """Send a ping; return False if it has to use the WebSocket."""
        if self._path is None:
            return False
        self._path.probe(payload)
        return True

    def status(self) -> dict[str, float]:
        """Return "datagrams" of /stats: whether a path is open, pictures sent and lost, share of lost packets."""
        path = self._path
        loss = 0.0 if path is None else round(path.loss, 4)
        return {"open": int(path is not None), "sent": self._sent, "lost": self._lost, "loss": loss}

    def close(self) -> None:
        """Close the path: the client has left."""
        self._listener.withdraw(self)
        if self._path is not None:
            self._path.end()

    # ------------------------------------------------------------------------------------------------------- PathUser

    def opened(self, path: DatagramPath) -> None:
        """Use the path for pictures."""
        self._path, self._before = path, self._sent

    def answered(self, payload: bytes) -> None:
        """Record an answer to a ping or a picture."""
        if self._session.link is not None:
            self._session.link.ponged(payload, self._clock())
            self._wake()

    def heard(self, message: bytes) -> None:
        """Queue a message."""
        self._heard.append(message)
        self._more.set()

    async def message(self) -> str:
        """Return the next message of the client."""
        while not self._heard:
            self._more.clear()
            await self._more.wait()
        return self._heard.popleft().decode("utf-8", "replace")

    def lost(self, frame_id: int) -> None:
        """Record a lost picture."""
        self._lost += 1
        self._session.lost(frame_id, self._clock())
        self._wake()

    def unanswered(self, frame_id: int) -> None:
        """Give up an unanswered picture."""
        self._session.give_up((frame_id,))
        self._wake()

    def closed(self) -> None:
        """Drop the path and give up its pictures."""
        self._path = None
        self._session.give_up(self._newest)  # QUIC may have acknowledged pictures that the client did not
        self._wake()
        self._listener.withdraw(self)
        if self._sent - self._before > _GOOD:
            self._pause, self._tries = _AGAIN, 0
