"""InternalClient: requests single pictures for the server itself, in turn with those of its clients."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass

from glsplat.errors import GlsplatError
from glsplat.net.backend import AvatarInfo
from glsplat.net.client_stream import ClientStream, Drawn
from glsplat.net.codec.encoded import Encoded
from glsplat.net.drawer import Drawer
from glsplat.net.messages import Decoder, Request, WireOptions
from glsplat.net.session import Session, SessionConfig

MIN_FPS = 15.0  # of pairs of pictures, for one client
SIDES_PX = (1024, 768, 512)  # of square pictures, the largest first
_WARM_UP = 1  # pictures that fill caches and are not timed
_TIMED = 2  # pictures
_MIN_PREDICTED_SHARE = 0.6  # of MIN_FPS: a part of a picture's time does not grow with its pixels


@dataclass(frozen=True, slots=True)
class Fitted:
    """A size: about ``rate`` pictures a second of ``side`` pixels can be drawn."""

    side: int
    rate: float

    @property
    def enough(self) -> bool:
        """Whether the rate suffices for moving pictures."""
        return self.rate >= MIN_FPS


async def fit(draw: Callable[[int], Awaitable[float]], most: int = SIDES_PX[0]) -> Fitted:
    """Return the largest of SIDES_PX up to ``most`` that is drawn MIN_FPS times a second, else the smallest.

    ``draw`` draws a pair of a side and returns the seconds that it took; the fastest counts, because a starting machine
    is busy. The smallest side is tried first, then those whose pixels predict a sufficient rate, to keep the start of a
    slow machine short.
    """
    sides = [side for side in SIDES_PX if side <= most] or [most]
    least = min(sides)
    found = Fitted(least, await _rate(draw, least))
    for side in sides:
        if side == least or found.rate * (least / side) ** 2 < _MIN_PREDICTED_SHARE * MIN_FPS:
            continue
        rate = await _rate(draw, side)
        if rate >= MIN_FPS:
            return Fitted(side, rate)
    return found


async def _rate(draw: Callable[[int], Awaitable[float]], side: int) -> float:
    for _ in range(_WARM_UP):
        await draw(side)
    return 1.0 / max(min([await draw(side) for _ in range(_TIMED)]), 1e-4)


log: logging.Logger = logging.getLogger("glsplat.net")

_TIMEOUT_S = 20.0  # of a picture


class InternalClient:
    """The client with the number 0. Its pictures are watermarked, too."""

    def __init__(self, drawer: Drawer, wire: WireOptions, session: SessionConfig, clock: Callable[[], float]) -> None:
        self._drawer, self._wire, self._config, self._clock = drawer, wire, session, clock
        self._one_at_a_time = asyncio.Lock()

    async def draw(
        self, avatar: AvatarInfo, request: Mapping[str, object], notice: Callable[[], str] = str
    ) -> tuple[Encoded, Mapping[str, float]]:
        """Return the picture of a native request, and its times in ms. Raises GlsplatError where it fails."""
        drawer = self._drawer
        async with self._one_at_a_time:  # all have the number 0
            session = Session(Decoder(self._wire, avatar.skeleton, avatar.parts), self._config, self._clock())
            taken = session.receive(json.dumps({"v": 1, "frame_id": 1, **request}), self._clock())
            if not isinstance(taken, Request):
                raise GlsplatError("the server's own request was rejected")
            client = ClientStream(0, session, address="the server's own pages", shown=avatar, notice=notice)
            drawer.add(client)
            client.received(taken, self._clock())
            try:
                answer = await asyncio.wait_for(client.answers.get(), _TIMEOUT_S)
                if not isinstance(answer, Drawn):
                    raise GlsplatError(f"it could not be drawn ({getattr(answer, 'code', 'render')})")
                return await answer.encoded, answer.times
            except TimeoutError:
                raise GlsplatError(f"it was not drawn within {_TIMEOUT_S:g} s") from None
            finally:
                drawer.remove(client)

    async def fit(self, avatar: AvatarInfo, max_side: int) -> Fitted | None:
        """Return the largest size at which ``avatar`` is drawn often enough; None where drawing fails."""

        async def draw(side: int) -> float:
            _, times = await self.draw(avatar, pair(avatar, side))
            return times["render"] / 1e3

        try:
            return await fit(draw, max_side)
        except GlsplatError:
            return None
        except Exception:  # the server goes on with the configured size
            log.exception("no picture size fits this client")
            return None


def pair(avatar: AvatarInfo, side: int) -> dict[str, object]:
    """Return a request for both eyes of a person 2.2 m in front of ``avatar``, which fills the picture."""
    height = avatar.height or 1.7
    focal = side * 2.2 / (1.15 * height)
    K = [focal, focal, side / 2, side / 2]
    eyes = [
        {"viewmat": [1, 0, 0, -x, 0, -1, 0, 0.5 * height, 0, 0, -1, 2.2, 0, 0, 0, 1], "K": K} for x in (-0.032, 0.032)
    ]
    return {"eyes": eyes, "size": [side, side], "crop": True, "alpha": "straight"}
