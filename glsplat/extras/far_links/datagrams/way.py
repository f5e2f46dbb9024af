"""The second way of one client: when it is offered, what goes over it, and what that means for its session.

The first is the WebSocket, over which requests and all else go, and pictures while there is no second.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from glsplat.extras.far_links.datagrams.roles import Host, Path
from glsplat.extras.far_links.link_control import LinkControl

if TYPE_CHECKING:
    from glsplat.net.session import Session

LONG = 0.008
"""Seconds there and back from which on it is worth it: what TCP waits for a lost packet. A machine's own are below."""
_AGAIN, _LONGER, _TRIES = 15.0, 3.0, 4  # seconds until it is offered again, times so much each time; how often
_GOOD = 200  # pictures after which a way that ends was a good one
_HEARD = 64  # messages that may wait, the newest
_WIDEST = 64  # more than a window is wide


class SecondWay:
    """``wake`` is called when a picture may be drawn that waited for another."""

    def __init__(
        self, listener: Host, session: Session, address: str, clock: Callable[[], float],
        wake: Callable[[], None],
    ) -> None:  # fmt: skip
        self._listener, self._session, self._address = listener, session, address
        self._clock, self._wake = clock, wake
        self._path: Path | None = None
        self._next, self._pause, self._tries = 0.0, _AGAIN, 0
        self._sent = self._lost = self._before = 0
        self._newest: deque[int] = deque(maxlen=_WIDEST)  # pictures that went this way
        self._heard: deque[bytes] = deque(maxlen=_HEARD)
        self._more = asyncio.Event()

    def offer(self) -> dict[str, str] | None:
        """What the next reply says, where a second way is wanted and worth it; it is offered seldom."""
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
        """Bytes that a picture of so many takes of the link, whichever way it goes now."""
        path = self._path
        return nbytes if path is None or not path.takes(nbytes) else round(nbytes * path.overhead(nbytes))

    def send(self, frame_id: int, picture: bytes) -> bool:
        """Whether the picture goes this way."""
        path, link = self._path, self._link
        if path is None or link is None or not path.takes(len(picture)):
            return False
        self._sent += 1
        self._newest.append(frame_id)
        path.send(frame_id, link.follow(frame_id), picture, link.link.rate)
        return True

    def ping(self, payload: bytes) -> bool:
        """Whether that ping goes this way."""
        if self._path is None:
            return False
        self._path.probe(payload)
        return True

    def status(self) -> dict[str, float]:
        """For /stats: whether there is one now, pictures that were sent and lost, and the share of packets lost."""
        path = self._path
        loss = 0.0 if path is None else round(path.loss, 4)
        return {"open": int(path is not None), "sent": self._sent, "lost": self._lost, "loss": loss}

    def close(self) -> None:
        """The client has left."""
        self._listener.withdraw(self)
        if self._path is not None:
            self._path.end()

    # ------------------------------------------------------------------------------------------------------- PathUser

    def opened(self, path: Path) -> None:
        """As in PathUser."""
        self._path, self._before = path, self._sent

    def answered(self, payload: bytes) -> None:
        """As in PathUser."""
        if self._session.link is not None:
            self._session.link.ponged(payload, self._clock())
            self._wake()

    def heard(self, message: bytes) -> None:
        """As in PathUser."""
        self._heard.append(message)
        self._more.set()

    async def message(self) -> str:
        """The next that the client sends this way; what is no text is nothing."""
        while not self._heard:
            self._more.clear()
            await self._more.wait()
        return self._heard.popleft().decode("utf-8", "replace")

    def lost(self, frame_id: int) -> None:
        """As in PathUser."""
        self._lost += 1
        self._session.lost(frame_id, self._clock())
        self._wake()

    def unanswered(self, frame_id: int) -> None:
        """As in PathUser."""
        self._session.give_up((frame_id,))
        self._wake()

    def closed(self) -> None:
        """As in PathUser."""
        self._path = None
        self._session.give_up(self._newest)  # QUIC may have them acknowledged, and the client none
        self._wake()
        self._listener.withdraw(self)
        if self._sent - self._before > _GOOD:
            self._pause, self._tries = _AGAIN, 0
