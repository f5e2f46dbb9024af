"""StudyLead: a running study as a feature of the server, with its routes and access control.

Participant and experimenter have one secret each, stored in the participant's folder, so their pages survive a restart.
Each page chooses a name and sends it with every request; only the newest page of the participant is served pictures,
those of the current condition.
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
from glsplat.extras.study.serving.live import Live, for_experimenter, for_participant, wrong_page
from glsplat.extras.study.serving.recording import Recording
from glsplat.extras.study.store import FRAMES, TRACKING
from glsplat.io.files import open_regular, replace_file
from glsplat.io.secret_files import warn_if_exposed
from glsplat.net.backend import PoseSolver, Solved
from glsplat.net.client_stream import ClientStream
from glsplat.net.feature import Feature, ServerView
from glsplat.net.messages import Request
from glsplat.net.options import NOT_ALLOWED, RequestedOptions
from glsplat.net.reply import parse_reply
from glsplat.net.rights import User

log: logging.Logger = logging.getLogger("glsplat.extras.study")

HEADER = "X-Glsplat-Study"
"""Header of requests to /study/...: the secret of the participant or the experimenter."""

KEYS = "keys.json"  # file of both secrets in a participant's folder

MIN_PAGE_NAME, MAX_PAGE_NAME = 8, 64  # characters
_LONG_POLL_S = 1.0
MAX_MESSAGE_BYTES = 48 << 10
_STATUS = dict.fromkeys(("elsewhere", "enter", "wrong_step", "paused"), 409)
_STATUS |= {"ended": 410, "full": 413, "bad_answer": 422, "bad_note": 422, "rate": 429}
_REPORT_S = 0.5  # least time between two recorded reports; the page reports once per second
_FIGURES = ("fps", "age_ms", "age_p95_ms", "rtt_ms", "frame_rate")
_JPEG_QUALITY = 80  # of the experimenter's picture

_PUBLIC = ("/vr", "/vr/{path}", "/healthz")  # static files and the health check
_PRIVATE = "a study runs here: open the page that it was started with"
_SET_BY_STUDY = ("avatar", "room", "name", "at", "label")  # URL parameters that the condition overrides

Handler = Callable[[web.Request, dict[str, Any]], Awaitable[web.Response]]

FULL = (1.0, 1.0, 1.0)  # no change

_GAMMA = 2.2  # of the display: a light factor f multiplies bytes by f ** (1 / 2.2)


def secrets_of(folder: Path) -> dict[str, str]:
    """Return the secrets "participant" and "experimenter" of a folder, created at the first call."""
    path = folder / KEYS
    if path.exists():
        with open_regular(path) as (file, _):
            data = file.read(4096)
        warn_if_exposed(path)
        try:
            found = json.loads(data)
            return {who: str(found[who]) for who in ("participant", "experimenter")}
        except (ValueError, KeyError, TypeError):
            raise FormatError(f"{path}: expected two secrets; delete it and it is made again") from None
    made = {who: secrets.token_urlsafe(18) for who in ("participant", "experimenter")}
    replace_file(path, [json.dumps(made).encode()], private=True)
    return made


class StudyLead(Feature):
    """The study as a feature. ``avatars``: the catalogue's name for each condition's avatar."""

    refusal = "nothing can be shown just now; tell the experimenter"

    def __init__(self, live: Live, avatars: Mapping[str, str]) -> None:
        self.live, self.secrets = live, secrets_of(live.store.folder)
        self._avatars = avatars
        self.tracking, self._frames = Recording(live.store.folder / TRACKING), Recording(live.store.folder / FRAMES)
        self._clients: dict[int, tuple[str, str]] = {}  # page and condition at the opening, by number
        self._steps = {step.alias: step.name for step in live.session.steps}
        self._heads = False  # whether all avatars can be shown without heads
        self.picture: bytes | None = None  # last reply
        self._reported = -math.inf  # time of the last recorded report, by ``live.t``
        self._end: Callable[[int, str], None] = lambda number, reason: None

    async def start(self, server: ServerView) -> None:
        """Start or resume the session."""
        self._end = server.close_client
        self._heads = all("head" in server.catalogue[name].parts for name in server.catalogue.names)
        self.live.changed = self._changed
        self._opening = asyncio.ensure_future(self.live.open())

    def routes(self) -> Sequence[web.RouteDef]:
        """Return the routes of both pages."""
        return [
            web.post("/study/state", self._for("participant", self._state)),
            web.post("/study/do", self._for("participant", self._do)),
            web.post("/study/watch", self._for("experimenter", self._watch)),
            web.post("/study/command", self._for("experimenter", self._command)),
            web.post("/study/picture", self._for("experimenter", self._picture_route)),
        ]

    @web.middleware
    async def guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Restrict all routes but those of the study's pages to the experimenter, also those of other features."""
        resource = request.match_info.route.resource
        address = "" if resource is None else resource.canonical
        open_ = address in _PUBLIC or address.startswith("/study/")  # these check their own secrets
        if address == "/ws":
            open_ = _same(request.query.get("study", ""), self.live.page)
        if open_ or _proves(request, self.secrets["experimenter"]):
            return await handler(request)
        return web.Response(status=403, text=f"{_PRIVATE}\n")

    def is_trusted(self, request: web.Request) -> bool:
        """Exempt holders of a secret from rate limits: each answer of a questionnaire takes several requests."""
        return any(_proves(request, secret) for secret in self.secrets.values())

    async def stop(self) -> None:
        """Close the log and the recordings."""
        await asyncio.gather(self._opening, return_exceptions=True)
        await self.live.close()
        await asyncio.to_thread(self.tracking.close)
        await asyncio.to_thread(self._frames.close)

    def query(self, asked: Mapping[str, str], user: User | None) -> Mapping[str, str]:
        """Set the condition's avatar for the participant's page; refuse all others."""
        condition = self.live.condition
        if not _same(asked.get("study", ""), self.live.page):
            raise ProtocolError(_PRIVATE, NOT_ALLOWED)
        if condition is None:
            raise ProtocolError("nothing is shown at this step of the study", NOT_ALLOWED)
        options = {name: value for name, value in asked.items() if name not in _SET_BY_STUDY}
        return options | {"avatar": self._avatars[condition.name]}

    def solver(self, solver: PoseSolver | None) -> PoseSolver | None:
        """Ignore hands in conditions without them."""
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

    def _changed(self) -> None:
        """Disconnect clients whose page or condition is outdated; they reconnect."""
        condition = self.live.condition
        now = (self.live.page, "" if condition is None else condition.name)
        for number, entered in list(self._clients.items()):
            if entered != now:
                self._end(number, "the study goes on")
                del self._clients[number]

    # requests of the pages

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
            except GlsplatError as error:  # of the disk; it names files, so only the experimenter may see it
                log.error("%s", error)
                text = str(error) if who == "experimenter" else "the server could not write this to its log; retrying"
                return _refusal(507, "disk", text)

        return answer

    async def _state(self, request: web.Request, message: dict[str, Any]) -> web.Response:
        live, page = self.live, self._page(message)
        live.touch()
        figures = message.get("figures")
        step = live.session.step
        if isinstance(figures, dict):
            live.figures = {key: v for key in _FIGURES if _is_number(v := figures.get(key))}
            live.figures["session"] = "vr" if figures.get("session") == "vr" else "page"
            if step is not None and live.condition is not None and live.t - self._reported >= _REPORT_S:
                self._reported = live.t
                self._frames.add(live.t, step.name, "frames", live.figures)
        after = message.get("after")
        await live.wait(after if isinstance(after, int) else -1, _LONG_POLL_S)
        if page != live.page:
            raise wrong_page()
        live.touch()
        return web.json_response(for_participant(live))

    async def _do(self, request: web.Request, message: dict[str, Any]) -> web.Response:
        live, session, what = self.live, self.live.session, message.get("do")
        step = self._steps.get(str(message.get("step", "")), "")
        if what == "enter":
            page = message.get("page")
            if not isinstance(page, str) or not MIN_PAGE_NAME <= len(page) <= MAX_PAGE_NAME or not page.isalnum():
                raise ProtocolError("a page has a name of 8 to 64 letters and digits")
            await live.enter(page)
            return web.json_response(for_participant(live) | {"heads": self._heads})
        self._page(message)
        live.touch()
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
        await self.live.wait(after if isinstance(after, int) else -1, _LONG_POLL_S)
        lost = self.tracking.lost + self._frames.lost
        return web.json_response(for_experimenter(self.live) | {"lost_lines": lost})

    async def _command(self, request: web.Request, message: dict[str, Any]) -> web.Response:
        session, what, text = self.live.session, message.get("do"), message.get("text", "")
        if not isinstance(text, str):
            raise ProtocolError("text needs words", "bad_note")
        commands: dict[str, Callable[[float], Sequence[Any]]] = {
            "pause": session.pause,
            "continue": session.resume,
            "repeat": session.repeat,
            "note": lambda t: session.note(text, t),
            "abort": lambda t: session.abort(text, t),
        }
        if not isinstance(what, str) or what not in commands:
            raise ProtocolError(f"do needs one of {', '.join(commands)}")
        await self.live.act(commands[what])
        return web.json_response(for_experimenter(self.live))

    async def _picture_route(self, request: web.Request, message: dict[str, Any]) -> web.Response:
        data = self.picture
        jpeg = None if data is None or self.live.condition is None else await asyncio.to_thread(_small, data)
        return web.Response(status=204) if jpeg is None else web.Response(body=jpeg, content_type="image/jpeg")

    def _page(self, message: Mapping[str, Any]) -> str:
        page = message.get("page")
        if not self.live.page:  # after a restart any page may enter
            raise ProtocolError("no page has entered yet; enter first", "enter")
        if page != self.live.page:
            raise wrong_page()
        return self.live.page


class _StudyObserver:
    """Observes one client and dims its pictures by the condition's ``light`` (RGB factors)."""

    def __init__(self, lead: StudyLead, light: tuple[float, float, float]) -> None:
        self._lead, self._light = lead, light

    def request_received(self, request: Request) -> None:
        live, step = self._lead.live, self._lead.live.session.step
        if request.tracking is not None and step is not None:
            values = request.tracking.to_json() | {"client_ms": request.t}
            self._lead.tracking.add(live.t, step.name, "tracking", values)

    def picture_drawn(self, images: NDArray[np.uint8]) -> None:
        if self._light != FULL:
            dim(images, self._light)

    def reply_sent(self, messages: Sequence[bytes]) -> None:
        self._lead.picture = messages[-1]


class _HeadOnly:
    """A solver that ignores all tracking but head, eyes and face."""

    def __init__(self, solver: PoseSolver) -> None:
        self._solver = solver

    def solve(self, request: Request, now: float) -> Solved:
        sample = request.tracking
        if sample is not None:
            kept = {name: getattr(sample, name) for name in ("expression", "left_eye", "right_eye")}
            head = type(sample)(sample.t, sample.head, **kept)
            request = replace(request, tracking=head)
        return self._solver.solve(request, now)


def _small(data: bytes) -> bytes | None:
    """Return the left eye's picture of a reply over black as a JPEG; None if it has none."""
    try:
        reply = parse_reply(data)
        images = reply.rgba() if reply.alphas else reply.images()
    except ProtocolError:
        return None
    return bytes(simplejpeg.encode_jpeg(images[0][..., :3].copy(), _JPEG_QUALITY))


def _proves(request: web.Request, secret: str) -> bool:
    return _same(request.headers.get(HEADER, ""), secret)


def _same(given: str, secret: str) -> bool:
    """Return whether two secrets are equal, in constant time; "" is invalid."""
    return bool(secret) and hmac.compare_digest(given.encode(errors="replace"), secret.encode())


async def _read(request: web.Request) -> dict[str, Any]:
    """Return the JSON object in a request. Raises ProtocolError."""
    if request.content_length is None or request.content_length > MAX_MESSAGE_BYTES:
        raise ProtocolError(f"a message has a length of at most {MAX_MESSAGE_BYTES} bytes")
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
    """Return an error response; ``wait``: seconds until the next try."""
    headers = None if wait is None else {"Retry-After": f"{wait}"}
    return web.json_response({"error": {"code": code, "message": text}}, status=status, headers=headers)


def dim(images: NDArray[np.uint8], light: tuple[float, float, float]) -> None:
    """Multiply the light of ``images`` [V, H, W, 4] by ``light`` [3], 0 to 1, linear RGB, in place.

    With a pure power as display curve, a byte's factor does not depend on alpha, so premultiplied edges stay correct.
    sRGB differs by its linear part near black.
    """
    values = np.arange(256)
    for channel, factor in enumerate(light):
        if factor != 1:
            table = np.rint(values * factor ** (1 / _GAMMA)).astype(np.uint8)
            images[..., channel] = table[images[..., channel]]
