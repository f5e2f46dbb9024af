"""One connection of a client: a task reads what the server sends and hands each answer to the one who waits for it.

Replies come in the order of their frame_id, and the newest request wins: once a later one is answered, an earlier one
never will be. Whoever waits for it is told so at once instead of waiting in vain.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from dataclasses import dataclass

import aiohttp
import msgspec

from glsplat.errors import ProtocolError
from glsplat.net.messages import VERSION
from glsplat.net.reply import Reply, parse_reply

__all__ = ["Arrived", "Connection"]

_UNREAD = 8  # pictures kept for receive(), the newest; the largest window of a server
_AFTERWARDS = ("render", "encode")  # errors of a picture that was taken in hand: older requests were replaced by it


@dataclass(frozen=True, slots=True, eq=False)
class Arrived:
    """A reply and when it came, on the clock of ``time.perf_counter``."""

    reply: Reply
    at: float  # seconds
    requested: float  # seconds; when its request was sent

    @property
    def communication_ms(self) -> float:
        """Round trip less the server's own time: both directions on the wire and in the sockets."""
        return max(0.0, (self.at - self.requested) * 1e3 - self.reply.info.get("times", {}).get("total", 0.0))


class Connection:
    """An open WebSocket and what is under way on it. Belongs to the event loop that made it."""

    def __init__(self, url: str, http: aiohttp.ClientSession, ws: aiohttp.ClientWebSocketResponse) -> None:
        self.loop = asyncio.get_running_loop()
        self.turn = asyncio.Lock()  # of those who ask for one picture and wait for it
        self.newest = 0  # frame_id of the newest request
        self.taken = 0  # frame_id of the newest picture that somebody took: what is acknowledged
        self._url = url
        self._http, self._ws = http, ws
        self._sent: dict[int, float] = {}  # frame_id: seconds
        self._waiting: dict[int, asyncio.Future[Arrived]] = {}
        self._given_up: set[int] = set()  # frame_ids whose waiter left: their pictures are for nobody
        self._unread: deque[Arrived | ProtocolError] = deque(maxlen=_UNREAD)
        self._news = asyncio.Event()
        self._said = ""  # the newest error that names no request, such as too many messages
        self._failure: ProtocolError | None = None
        self._task = asyncio.create_task(self._read(), name="glsplat client")

    @property
    def alive(self) -> bool:
        """False once the server has gone away or the connection was closed."""
        return self._failure is None

    @property
    def waiting(self) -> bool:
        """True while the newest request has no answer."""
        return self.newest in self._sent

    async def close(self) -> None:
        """Wake all who wait, with an error, and close the socket."""
        self._fail(ProtocolError(f"{self._url}: the client was closed", "closed"))
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        await self._ws.close()
        await self._http.close()

    async def ask(self, frame_id: int, text: str, now: float) -> None:
        """Send a request, whose picture will come by ``next``, if it comes."""
        self.newest = frame_id
        self._sent[frame_id] = now
        try:
            await self.send_text(text)
        except ProtocolError:
            self._sent.pop(frame_id, None)
            raise

    async def send_text(self, text: str) -> None:
        """Raises ProtocolError when the connection has ended."""
        if self._failure is not None:
            raise self._ended()
        try:
            await self._ws.send_str(text)
        except (ConnectionError, aiohttp.ClientError):
            raise ProtocolError(f"{self._url}: the server closed the connection", "closed") from None

    async def acknowledge(self) -> None:
        """Tell the server what was taken."""
        await self.send_text(f'{{"v":{VERSION},"ack":{self.taken}}}')

    def take_all(self) -> None:
        """Acknowledge, with the next message, also what receive() has not taken: a full window would hold it back."""
        for item in self._unread:
            if isinstance(item, Arrived):
                self.taken = max(self.taken, item.reply.frame_id)

    async def ask_and_wait(self, frame_id: int, text: str, now: float, timeout: float) -> Arrived:
        """Send a request and wait for its picture. Raises the server's error, or one that says it was replaced."""
        future = self._waiting[frame_id] = self.loop.create_future()  # before sending: the answer may be quick
        try:
            await self.ask(frame_id, text, now)
            async with asyncio.timeout(timeout):
                return await future
        except TimeoutError:
            text = f"{self._url}: no picture for request {frame_id} within {timeout:g} s"
            if self.newest > frame_id:
                text += f"; a newer one ({self.newest}) may have replaced it"
            if self._said:
                text += f"; the server said: {self._said}"
            raise ProtocolError(text, "timeout", frame_id) from None
        finally:
            del self._waiting[frame_id]
            if frame_id in self._sent:
                self._given_up.add(frame_id)
            if future.done() and not future.cancelled():
                future.exception()  # looked at, also where nobody awaits it any more

    async def next(self, timeout: float) -> Arrived:
        """The next picture nobody waits for by its number; acknowledged at once when newer requests are under way."""
        try:
            async with asyncio.timeout(timeout):
                while not self._unread:
                    if self._failure is not None:
                        raise self._ended()
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            raise ProtocolError(f"{self._url}: no picture within {timeout:g} s", "timeout") from None
        item = self._unread.popleft()
        if isinstance(item, ProtocolError):
            raise item
        self.taken = max(self.taken, item.reply.frame_id)
        if self._sent and self._failure is None:
            await self.acknowledge()
        return item

    # ------------------------------------------------------------------------------------------------- the reader

    async def _read(self) -> None:
        failure = ProtocolError(f"{self._url}: the server closed the connection", "closed")
        try:
            while True:
                message = await self._ws.receive()
                if message.type == aiohttp.WSMsgType.TEXT:
                    self._refused(_server_error(message.data))
                elif message.type == aiohttp.WSMsgType.BINARY:
                    await self._arrived(parse_reply(message.data), time.perf_counter())
                else:
                    why = "" if self._ws.close_code is None else f" ({self._ws.close_code})"
                    failure = ProtocolError(f"{self._url}: the server closed the connection{why}", "closed")
                    return
        except ProtocolError as error:  # no reply, or nobody to acknowledge it to
            failure = error
        finally:
            self._fail(failure)

    async def _arrived(self, reply: Reply, at: float) -> None:
        number = reply.frame_id
        requested = self._sent.pop(number, None)
        if requested is None:  # answered before, or never asked for
            return
        self._replaced(number)
        future = self._waiting.get(number)
        if future is not None:
            if not future.done():
                future.set_result(Arrived(reply, at, requested))
        elif number not in self._given_up:
            self._unread.append(Arrived(reply, at, requested))
            self._news.set()
            if not self._waiting:  # else it must not hold back the picture that is waited for
                return
        self._given_up.discard(number)
        self.taken = max(self.taken, number)
        if self._sent:
            await self.acknowledge()

    def _refused(self, error: ProtocolError) -> None:
        """The server's error about one request; without a number, it is about what is waited for."""
        number = error.frame_id
        if number is None:
            self._said = str(error)
            number = next(iter(self._waiting), None)
        if number is not None:
            self._sent.pop(number, None)
            if error.code in _AFTERWARDS:
                self._replaced(number)
        future = None if number is None else self._waiting.get(number)
        if future is not None:
            if not future.done():
                future.set_exception(error)
        elif number not in self._given_up:
            self._unread.append(error)
            self._news.set()
        self._given_up.discard(number or 0)

    def _replaced(self, number: int) -> None:
        """Requests before this one will never be answered."""
        for old in [frame_id for frame_id in self._sent if frame_id < number]:
            del self._sent[old]
            self._given_up.discard(old)
            future = self._waiting.get(old)
            if future is not None and not future.done():
                text = (
                    f"{self._url}: request {old} was dropped for a newer one ({number}); send() or render(), not both"
                )
                future.set_exception(ProtocolError(text, "dropped", old))

    def _fail(self, failure: ProtocolError) -> None:
        if self._failure is not None:
            return
        self._failure = failure
        self._sent.clear()
        for future in self._waiting.values():
            if not future.done():
                future.set_exception(self._ended())
        self._news.set()

    def _ended(self) -> ProtocolError:
        """A new one for each that waits: an exception that is raised twice carries two tracebacks."""
        assert self._failure is not None
        return ProtocolError(str(self._failure), self._failure.code)


def _server_error(text: str) -> ProtocolError:
    try:
        error = msgspec.json.decode(text)["error"]
        number = error.get("frame_id")
        return ProtocolError(str(error["message"]), str(error["code"]), number if isinstance(number, int) else None)
    except (msgspec.MsgspecError, KeyError, TypeError, AttributeError):
        return ProtocolError("the server sent a text message that is not an error", "bad_reply")
