"""StudyLead: what a running study says to the server of it, its addresses, and who may ask for them.

Participant and experimenter have a secret each, kept in the participant's folder, so that their pages go on after a
crash. A page makes up a name of its own and says it with all it does: of two pages the newer one counts. Only that
page's pictures are drawn, as the condition has them.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import math
import secrets
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import simplejpeg
from aiohttp import web
from numpy.typing import NDArray

from glsplat.errors import FormatError, GlsplatError, ProtocolError
from glsplat.extras.study.serving.light import FULL, dim
from glsplat.extras.study.serving.live import Live, wrong_page
from glsplat.extras.study.serving.recording import Recording
from glsplat.extras.study.serving.seen import for_experimenter, for_participant
from glsplat.extras.study.store import FRAMES, TRACKING
from glsplat.io.files import open_regular, replace_file
from glsplat.io.secret_files import warn_if_exposed
from glsplat.net.backend import PoseSolver, Solved
from glsplat.net.client_stream import ClientStream
from glsplat.net.feature import Feature, ServerView
from glsplat.net.messages import Request
from glsplat.net.options import NOT_ALLOWED, RequestedOptions
from glsplat.net.reply import parse_reply

__all__ = ["HEADER", "KEYS", "StudyLead", "secrets_of"]

log: logging.Logger = logging.getLogger("glsplat.extras.study")

HEADER = "X-Glsplat-Study"
"""Of each request to /study/...: the secret of the participant, or of the experimenter."""

KEYS = "keys.json"
"""Of a participant's folder: both secrets."""

_PAGE = 8, 64  # characters of a page's own name
_HOLD = 1.0  # seconds that a page waits for news
_LARGEST = 48 << 10  # bytes of a message
_STATUS = {
    "elsewhere": 409,
    "enter": 409,
    "wrong_step": 409,
    "paused": 409,
    "ended": 410,
    "full": 413,
    "bad_answer": 422,
    "bad_note": 422,
    "rate": 429,
}
_REPORT_S = 0.5  # between two lines of figures; the page reports once a second
_FIGURES = ("fps", "age_ms", "age_p95_ms", "rtt_ms", "frame_rate")
_PICTURE = 80  # quality of the experimenter's JPEG

_PUBLIC = ("/vr", "/vr/{path}", "/healthz")  # files of the package, and whether the server is well
_PRIVATE = "a study runs here: open the page that it was started with"
_CHOSEN = ("avatar", "room", "name", "at", "label")  # of a client's address: what the condition says instead

Handler = Callable[[web.Request, dict[str, Any]], Awaitable[web.Response]]


def secrets_of(folder: Path) -> dict[str, str]:
    """The secrets "participant" and "experimenter" of a participant's folder, made when they are asked for first."""
    path = folder / KEYS
    if path.exists():
        with open_regular(path) as (file, _):
            data = file.read(4096)
        warn_if_exposed(path)
        try:
            found = json.loads(data)
            return {who: str(found[who]) for who in ("participant", "experimenter")}
        except (ValueError, KeyError, TypeError):
            raise FormatError(f"{path}: expected two secrets; delete it, and it is made anew") from None
    made = {who: secrets.token_urlsafe(18) for who in ("participant", "experimenter")}
    replace_file(path, [json.dumps(made).encode()], private=True)
    return made


class StudyLead(Feature):
    """The study as a feature of its server. ``avatars``: the name under which each condition's is offered."""

    refusal = "nothing can be shown just now; tell the experimenter"

    def __init__(self, live: Live, avatars: Mapping[str, str]) -> None:
        self.live, self.secrets = live, secrets_of(live.store.folder)
        self._avatars = avatars
        self._tracking, self._frames = Recording(live.store.folder / TRACKING), Recording(live.store.folder / FRAMES)
        self._clients: dict[int, tuple[str, str]] = {}  # by number: the page, and the condition that it was let in for
        self._steps = {step.alias: step.name for step in live.session.steps}
        self._heads = False  # whether all avatars can be shown without their heads
        self._picture: bytes | None = None  # the last reply
        self._reported = -math.inf  # when the page's figures were written down last, by ``live.t``
        self._end: Callable[[int, str], None] = lambda number, reason: None

    async def start(self, server: ServerView) -> None:
        """Begin the session, or go on with it."""
        self._end = server.close_client
        self._heads = all("head" in server.catalogue[name].parts for name in server.catalogue.names)
        self.live.changed = self._changed
        self._opening = asyncio.ensure_future(self.live.open())

    def routes(self) -> Sequence[web.RouteDef]:
        """Return the addresses of both pages."""
        return [
            web.post("/study/state", self._for("participant", self._state)),
            web.post("/study/do", self._for("participant", self._do)),
            web.post("/study/watch", self._for("experimenter", self._watch)),
            web.post("/study/command", self._for("experimenter", self._command)),
            web.post("/study/picture", self._for("experimenter", self._shown)),
        ]

    @web.middleware
    async def guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """A study is private: whatever is not for its pages is for the experimenter alone, also addresses to come."""
        resource = request.match_info.route.resource
        address = "" if resource is None else resource.canonical
        open_ = address in _PUBLIC or address.startswith("/study/")  # the latter ask for their secrets themselves
        if address == "/ws":
            open_ = _same(request.query.get("study", ""), self.live.page)
        if open_ or _proves(request, self.secrets["experimenter"]):
            return await handler(request)
        return web.Response(status=403, text=f"{_PRIVATE}\n")

    def is_trusted(self, request: web.Request) -> bool:
        """Each answer is a message and the news of it for both pages: an experimenter has to be heard all the same."""
        return any(_proves(request, secret) for secret in self.secrets.values())

    async def stop(self) -> None:
        """Write down what is left."""
        await asyncio.gather(self._opening, return_exceptions=True)
        await self.live.close()
        await asyncio.to_thread(self._tracking.close)
        await asyncio.to_thread(self._frames.close)

    def query(self, asked: Mapping[str, str]) -> Mapping[str, str]:
        """The avatar of the condition for the participant's page; nobody else is shown anything."""
        condition = self.live.condition
        if not _same(asked.get("study", ""), self.live.page):
            raise ProtocolError(_PRIVATE, NOT_ALLOWED)
        if condition is None:
            raise ProtocolError("nothing is shown at this step of the study", NOT_ALLOWED)
        options = {name: value for name, value in asked.items() if name not in _CHOSEN}
        return options | {"avatar": self._avatars[condition.name]}

    def solver(self, solver: PoseSolver | None) -> PoseSolver | None:
        """Without hands where the condition is of the head alone."""
        condition = self.live.condition
        return _HeadOnly(solver) if solver is not None and condition is not None and not condition.hands else solver

    def client_opened(self, client: ClientStream, asked: RequestedOptions) -> None:
        """Record the client's tracking and keep its last picture."""
        condition = self.live.condition
        self._clients[client.number] = (self.live.page, "" if condition is None else condition.name)
        client.observe(_StudyObserver(self, FULL if condition is None else condition.light))

    def client_closed(self, client: ClientStream, goodbye: bool) -> None:
        """Forget the client."""
        self._clients.pop(client.number, None)

    def heard(self, request: Request) -> None:
        """A request of the participant's page."""
        step = self.live.session.step
        if request.tracking is not None and step is not None:
            values = request.tracking.to_json() | {"client_ms": request.t}
            self._tracking.add(self.live.t, step.name, "tracking", values)

    def shown(self, message: bytes) -> None:
        """A reply was sent to it."""
        self._picture = message

    def _changed(self) -> None:
        """Whoever is shown what is no longer to be seen is put out, and comes back to what is."""
        condition = self.live.condition
        now = (self.live.page, "" if condition is None else condition.name)
        for number, entered in list(self._clients.items()):
            if entered != now:
                self._end(number, "the study goes on")
                del self._clients[number]

    # what pages ask

    def _for(self, who: str, handler: Handler) -> Callable[[web.Request], Awaitable[web.Response]]:
        async def answer(request: web.Request) -> web.Response:
            if not _proves(request, self.secrets[who]):
                return _refusal(403, "not_allowed", f"this needs the {who}'s own link")
            try:
                if self._opening.done() and self._opening.exception() is not None:
                    self._opening = asyncio.ensure_future(self.live.open())  # the disk was full: there may be room now
                await asyncio.shield(self._opening)
                message = await _read(request)
                return await handler(request, message)
            except ProtocolError as error:
                return _refusal(_STATUS.get(error.code, 400), error.code, str(error), getattr(error, "wait", None))
            except GlsplatError as error:  # of the disk: it names files, which is for the experimenter alone
                log.error("%s", error)
                text = str(error) if who == "experimenter" else "this could not be written down; it is tried again"
                return _refusal(507, "disk", text)

        return answer

    async def _state(self, request: web.Request, message: dict[str, Any]) -> web.Response:
        live, page = self.live, self._page(message)
        live.seen()
        figures = message.get("figures")
        step = live.session.step
        if isinstance(figures, dict):
            live.figures = {key: v for key in _FIGURES if _is_number(v := figures.get(key))}
            live.figures["session"] = "vr" if figures.get("session") == "vr" else "page"
            if step is not None and live.condition is not None and live.t - self._reported >= _REPORT_S:
                self._reported = live.t
                self._frames.add(live.t, step.name, "frames", live.figures)
        after = message.get("after")
        await live.wait(after if isinstance(after, int) else -1, _HOLD)
        if page != live.page:
            raise wrong_page()
        live.seen()
        return web.json_response(for_participant(live))

    async def _do(self, request: web.Request, message: dict[str, Any]) -> web.Response:
        live, session, what = self.live, self.live.session, message.get("do")
        step = self._steps.get(str(message.get("step", "")), "")
        if what == "enter":
            page = message.get("page")
            if not isinstance(page, str) or not _PAGE[0] <= len(page) <= _PAGE[1] or not page.isalnum():
                raise ProtocolError("a page has a name of 8 to 64 letters and digits")
            await live.enter(page)
            return web.json_response(for_participant(live) | {"heads": self._heads})
        self._page(message)
        live.seen()
        if what == "consent":
            if not isinstance(message.get("accepted"), bool):
                raise ProtocolError("accepted needs true or false")
            await live.act(lambda t: session.consent(step, message["accepted"], t), link=True)
        elif what == "ready":
            await live.act(lambda t: session.ready(step, t), link=True)
        elif what == "answer":
            item, seconds = str(message.get("item", "")), message.get("seconds", -1)
            took = float(seconds) if _is_number(seconds) else -1.0
            await live.act(lambda t: session.answer(step, item, message.get("value"), took, t), link=True)
        elif what == "submit":
            await live.act(lambda t: session.submit(step, t), link=True)
        else:
            raise ProtocolError("do needs enter, consent, ready, answer or submit")
        return web.json_response(for_participant(live))

    async def _watch(self, request: web.Request, message: dict[str, Any]) -> web.Response:
        after = message.get("after")
        await self.live.wait(after if isinstance(after, int) else -1, _HOLD)
        lost = self._tracking.lost + self._frames.lost
        return web.json_response(for_experimenter(self.live) | {"lost_lines": lost})

    async def _command(self, request: web.Request, message: dict[str, Any]) -> web.Response:
        session, what, text = self.live.session, message.get("do"), message.get("text", "")
        if not isinstance(text, str):
            raise ProtocolError("text needs words", "bad_note")
        commands: dict[str, Callable[[float], Sequence[Any]]] = {
            "pause": session.pause,
            "continue": session.go_on,
            "repeat": session.repeat,
            "note": lambda t: session.note(text, t),
            "abort": lambda t: session.abort(text, t),
        }
        if not isinstance(what, str) or what not in commands:
            raise ProtocolError(f"do needs one of {', '.join(commands)}")
        await self.live.act(commands[what])
        return web.json_response(for_experimenter(self.live))

    async def _shown(self, request: web.Request, message: dict[str, Any]) -> web.Response:
        data = self._picture
        jpeg = None if data is None or self.live.condition is None else await asyncio.to_thread(_small, data)
        return web.Response(status=204) if jpeg is None else web.Response(body=jpeg, content_type="image/jpeg")

    def _page(self, message: Mapping[str, Any]) -> str:
        page = message.get("page")
        if not self.live.page:  # the server is new: whoever asks first goes on
            raise ProtocolError("no page has entered yet; enter first", "enter")
        if page != self.live.page:
            raise wrong_page()
        return self.live.page


class _StudyObserver:
    """Observes one client and dims its pictures by the ``light`` (RGB factors) of its condition."""

    def __init__(self, lead: StudyLead, light: tuple[float, float, float]) -> None:
        self._lead, self._light = lead, light

    def request_received(self, request: Request) -> None:
        self._lead.heard(request)

    def picture_drawn(self, images: NDArray[np.uint8]) -> None:
        if self._light != FULL:
            dim(images, self._light)

    def reply_sent(self, messages: Sequence[bytes]) -> None:
        self._lead.shown(messages[-1])


class _HeadOnly:
    """A solver that is not told of hands, nor of what else is tracked."""

    def __init__(self, solver: PoseSolver) -> None:
        self._solver = solver

    def solve(self, request: Request, now: float) -> Solved:
        sample = request.tracking
        if sample is not None:
            head = type(sample)(
                sample.t,
                sample.head,
                expression=sample.expression,
                left_eye=sample.left_eye,
                right_eye=sample.right_eye,
            )
            request = replace(request, tracking=head)
        return self._solver.solve(request, now)


def _small(data: bytes) -> bytes | None:
    """The left eye's picture of a reply over black, as a JPEG; None for what has none."""
    try:
        reply = parse_reply(data)
        images = reply.rgba() if reply.alphas else reply.images()
    except ProtocolError:
        return None
    return bytes(simplejpeg.encode_jpeg(images[0][..., :3].copy(), _PICTURE))


def _proves(request: web.Request, secret: str) -> bool:
    return _same(request.headers.get(HEADER, ""), secret)


def _same(given: str, secret: str) -> bool:
    """Whether the two are the same, in a time that does not depend on where they differ; "" is no secret."""
    return bool(secret) and hmac.compare_digest(given.encode(errors="replace"), secret.encode())


async def _read(request: web.Request) -> dict[str, Any]:
    """The JSON object of a message. Raises ProtocolError."""
    if request.content_length is None or request.content_length > _LARGEST:
        raise ProtocolError(f"a message has a length of at most {_LARGEST} bytes")
    try:
        message = json.loads(await request.read())
    except (ValueError, RecursionError):
        raise ProtocolError("a message is a JSON object") from None
    if not isinstance(message, dict):
        raise ProtocolError("a message is a JSON object")
    return message


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9


def _refusal(status: int, code: str, text: str, wait: int | None = None) -> web.Response:
    """``wait``: seconds after which to try again."""
    headers = None if wait is None else {"Retry-After": f"{wait}"}
    return web.json_response({"error": {"code": code, "message": text}}, status=status, headers=headers)
