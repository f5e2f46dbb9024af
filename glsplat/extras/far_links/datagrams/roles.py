"""Who has to do with whom: a path, the client that uses it, and the host that lets clients come."""

from __future__ import annotations

from typing import Protocol


class PathUser(Protocol):
    """What a path tells its client. All of it is called on the event loop, and is to return at once."""

    def opened(self, path: Path) -> None:
        """Pictures may be sent."""
        ...

    def answered(self, payload: bytes) -> None:
        """A ping came back, or the nonce of a picture that is there."""
        ...

    def heard(self, message: bytes) -> None:
        """A message of the client's: what else comes over the WebSocket."""
        ...

    def lost(self, frame_id: int) -> None:
        """That picture will not arrive."""
        ...

    def unanswered(self, frame_id: int) -> None:
        """That picture did arrive, as QUIC has it, and its client has said nothing of it for long."""
        ...

    def closed(self) -> None:
        """Nothing can be sent any more."""
        ...


class Path(Protocol):
    """One client's connection by datagrams (path.py)."""

    @property
    def loss(self) -> float:
        """Share of the packets that is lost."""
        ...

    def overhead(self, nbytes: int) -> float:
        """Bytes on the way for each byte of a picture of that size."""
        ...

    def takes(self, nbytes: int) -> bool:
        """Whether a picture of so many bytes can go this way now."""
        ...

    def send(self, frame_id: int, nonce: bytes, picture: bytes, rate: float) -> None:
        """A picture, over a link that takes ``rate`` bits a second."""
        ...

    def probe(self, payload: bytes) -> None:
        """A small message that the client sends back."""
        ...

    def end(self) -> None:
        """Close it."""
        ...


class Host(Protocol):
    """Where clients come in (listener.py)."""

    def offer(self, address: str, user: PathUser) -> dict[str, str] | None:
        """What a client is told; None: nobody is let in now."""
        ...

    def withdraw(self, user: PathUser) -> None:
        """The client has left."""
        ...
