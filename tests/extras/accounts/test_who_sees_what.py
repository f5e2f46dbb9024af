"""Every address of every kind of server, and what each kind of visitor finds there. A new address wants a row here."""

from __future__ import annotations

import base64
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from glsplat.extras.accounts.users import Accounts, new_user, write_users
from glsplat.extras.browser.feature import SplatFiles
from glsplat.extras.browser.web_format.write import web_file
from glsplat.extras.consent.document import Consent
from glsplat.extras.consent.file import OnFile
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.extras.operations.previews import Previews
from glsplat.extras.study.serving.lead import StudyLead
from glsplat.extras.study.serving.live import Live
from glsplat.extras.uploads.job import UploadConfig
from glsplat.extras.uploads.routes import Uploads
from glsplat.extras.watermark.keys import new_watermark
from glsplat.net.backend import AvatarInfo
from glsplat.net.client import Client
from glsplat.net.guard.access import Access
from glsplat.net.served_scene import server_of
from glsplat.net.server import Server, ServerConfig
from glsplat.net.session import SessionConfig
from tests.extras.accounts.test_accounts import WS
from tests.extras.browser.poses.conftest import RIG, avatar
from tests.extras.study.designs import planned
from tests.extras.uploads.conftest import LIMITS, described
from tests.extras.uploads.makers import make
from tests.net.conftest import FakeBackend, eyes
from tests.net.wire import HANG, native

TOKEN = "0123456789abcdef"
UNGUARDED = replace(LIMITS, guesses=10**9)
MADE = "photo-madebyme"
KEY = "ab" * 32

ACCOUNTS = {
    "eve": ([], []),  # an account with nothing
    "ann": (["ann-avatar"], ["ann-room"]),
    "bob": (["bob-avatar"], ["bob-room"]),
    "meg": ([], []),  # had an avatar made, and has another one made now
    "all": (["*"], ["*"]),
}
VISITORS = ("nobody", "wrong", *ACCOUNTS)
HIDDEN = "404"


@dataclass(frozen=True)
class Row:
    """What an address tells. ``sees``: by visitor, the status and the facts; ``usual`` for the accounts left out."""

    route: str
    path: str = ""
    usual: str = "200"
    sees: Mapping[str, str] = field(default_factory=dict)
    absent: str = ""  # the same address of something that is not there: it reads like what is not the asker's

    @property
    def method(self) -> str:
        return self.route.split()[0]

    @property
    def address(self) -> str:
        return self.path or self.route.split()[1]

    def of(self, visitor: str) -> str:
        if self.route in PUBLIC:
            return self.usual
        return self.sees.get(visitor, "401" if visitor in ("nobody", "wrong") else self.usual)


PUBLIC = {"GET /healthz", "GET /vr", "GET /vr/{path}"}
_ANN, _BOB = "ann-avatar ann-room ann-mark", "bob-avatar bob-room bob-mark"
OWN = {"bob": "403 bob-avatar", "meg": "403 made"}  # what they may ask for instead
SHOWN, SPLATS = dict.fromkeys(("ann", "all"), "200"), dict.fromkeys(("ann", "all"), "200 ann-splats")
TABLE = (
    Row("GET /healthz"),
    Row("GET /vr", usual="308"),
    Row("GET /vr/{path}", "/vr/study.html"),
    Row("GET /", sees={"ann": "200 ann-avatar", "bob": "200 bob-avatar", "all": "200 scene-file"}),
    Row("GET /stats", sees={"ann": f"200 {_ANN}", "bob": f"200 {_BOB}", "all": "200 scene-file ann-room bob-room"}),
    Row(
        "GET /status.json",
        sees={
            "ann": f"200 {_ANN} ann-picture",
            "bob": f"200 {_BOB} bob-picture",
            "meg": "200 made",
            "all": "200 scene scene-file ann-avatar bob-avatar ann-room bob-room",
        },
    ),
    Row(
        "GET /session",
        sees={
            "ann": "200 ann-avatar ann-room",
            "bob": "200 bob-avatar bob-room",
            "meg": "200 made",
            "all": "200 scene ann-avatar bob-avatar ann-room bob-room",
        },
    ),
    Row("GET /metrics"),
    Row("GET /history"),
    Row("GET /reach"),
    Row("GET /recording"),
    Row("GET /motions/{name}", "/motions/idle"),
    Row("GET /thumbnails/{name}", "/thumbnails/ann-avatar", HIDDEN, SHOWN, "/thumbnails/of-nobody"),
    Row("GET /thumbnails/{name}", f"/thumbnails/{MADE}", HIDDEN, {"meg": "200"}, "/thumbnails/photo-abcdefgh"),
    Row("GET /pictures/{number}", "/pictures/1", HIDDEN, {"ann": "200 ann-picture"}, "/pictures/77"),
    Row("GET /pictures/{number}", "/pictures/2", HIDDEN, {"bob": "200 bob-picture"}, "/pictures/77"),
    Row("GET /splats/{sha256}", "/splats/{ann_splats}", HIDDEN, SPLATS, f"/splats/{'0' * 64}"),
    Row("GET /ws", "/ws?avatar=ann-avatar", "403", {"ann": "101", "all": "101", **OWN}, "/ws?avatar=of-nobody"),
    Row(
        "GET /ws",
        f"/ws?avatar={MADE}",
        "403",
        {"meg": "101", "ann": "403 ann-avatar", "bob": "403 bob-avatar", "all": "403 ann-avatar bob-avatar"},
        "/ws?avatar=photo-abcdefgh",
    ),
    Row(
        "GET /ws",
        "/ws?avatar=bob-avatar&room=ann-room",
        "403",
        {"all": "101", "ann": "403 ann-avatar", "meg": "403 made"},
        "/ws?avatar=bob-avatar&room=nowhere",
    ),
    Row("GET /ws", "/ws?name=ann", "403", {"ann": "101"}, "/ws?name=zoe"),
    Row("POST /avatars", usual="415"),
    Row("GET /avatars/{name}", "/avatars/{job}", HIDDEN, {"meg": "200 job"}, "/avatars/photo-abcdefgh"),
    Row(
        "POST /avatars/{name}/anyway", "/avatars/{job}/anyway", HIDDEN, {"meg": "409"}, "/avatars/photo-abcdefgh/anyway"
    ),
    Row("DELETE /avatars/{name}", "/avatars/default", "403", absent="/avatars/of-nobody"),
    Row("DELETE /avatars/{name}", f"/avatars/{MADE}", HIDDEN, {"meg": "204"}, "/avatars/photo-abcdefgh"),
    Row("DELETE /avatars/{name}", "/avatars/{job}", HIDDEN, {"meg": "204"}, "/avatars/photo-abcdefgh"),
)
STUDY = {f"POST /study/{what}" for what in ("state", "do", "watch", "command", "picture")}
"""Rows of their own: tests/extras/study/serving/test_private.py."""


@dataclass
class World:
    """A server with accounts on which ann is in her room, bob in his, and meg has an avatar made."""

    server: Server
    http: aiohttp.ClientSession
    tokens: dict[str, str]
    facts: dict[str, bytes]  # what each of them reads like
    names: dict[str, str]  # for addresses

    async def ask(self, visitor: str, method: str, path: str) -> tuple[int, dict[str, str], bytes]:
        """Status, headers without the date, body. The connection is ended behind a handshake."""
        token = {"nobody": "", "wrong": "ann.wrong"}.get(visitor) if visitor in ("nobody", "wrong") else None
        token = self.tokens[visitor] if token is None else token
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        headers |= WS if path.startswith("/ws") else {}
        url = f"http://127.0.0.1:{self.server.port}{path.format(**self.names)}"
        options: dict[str, Any] = {"headers": headers, "allow_redirects": False}
        async with self.http.request(method, url, **options) as answer:
            found = {name: value for name, value in answer.headers.items() if name != "Date"}
            return answer.status, found, b"" if answer.status == 101 else await answer.read()

    def told(self, body: bytes) -> set[str]:
        """The facts that a body tells."""
        forms = {name: (pattern, base64.b64encode(pattern)) for name, pattern in self.facts.items()}
        return {name for name, either in forms.items() if any(one in body for one in either)}


def offers() -> tuple[AvatarInfo, ...]:
    def one(name: str, seed: int, **more: Any) -> AvatarInfo:
        return AvatarInfo(name=name, skeleton=RIG, file=lambda: web_file(avatar(40, seed)), **more)

    return one("scene-avatar", 1), one("ann-avatar", 2), one("bob-avatar", 3), one(MADE, 4, made=True)


def policy() -> ConsentPolicy:
    """Anybody may be shown; meg's avatar, made here, to her alone."""
    found = ConsentPolicy()
    found.trust_own(KEY)
    for one in offers():
        found.add(one.name, [OnFile(nobody=True)])
    now = time.time()
    record = Consent(
        subject="meg", given_by="meg", purpose="a test", key=KEY, begins=now - 1e6, ends=now + 1e6,
        drivers=frozenset(["meg"]), splats_sha256="0" * 64, file_sha256=None, hand_out=True,
    )  # fmt: skip
    found.add(MADE, [OnFile(record)])
    return found


@asynccontextmanager
async def running(config: ServerConfig, folder: Path, uploads: bool = True, lead: Any = None) -> AsyncIterator[Server]:
    made = Uploads(UploadConfig(folder=folder / "avatars", make=make), described) if uploads else None
    if made is not None:
        made.store.open()
    features = [feature for feature in (made, lead) if feature is not None]
    server = server_of(FakeBackend(), config, offers(), features)
    await server.start()
    try:
        await server.all_offered.wait()
        yield server
    finally:
        await server.stop()


@asynccontextmanager
async def world(folder: Path, **changes: Any) -> AsyncIterator[World]:
    made = {name: new_user(name, *rights) for name, rights in ACCOUNTS.items()}
    write_users(folder / "users.json", {name: user for name, (user, _) in made.items()})
    tokens = {name: token for name, (_, token) in made.items()}
    config = ServerConfig(
        port=0, access=Access(accounts=Accounts(folder / "users.json")), consent=policy(), limits=UNGUARDED,
        rooms={"ann-room": 4, "bob-room": 4}, scene="scene-file.glb", session=SessionConfig(watermark=new_watermark()),
        max_clients=64, **changes,
    )  # fmt: skip
    async with running(config, folder) as server, aiohttp.ClientSession() as http:
        for name in tokens:  # their hashes are taken once
            url = f"http://127.0.0.1:{server.port}/history"
            async with http.get(url, headers={"Authorization": f"Bearer {tokens[name]}"}) as answer:
                assert answer.status == 200
        assert server.feature(Uploads) is not None
        job = server.feature(Uploads)._queue.book("127.0.0.9", "meg")
        ann = Client(f"{server.url}?room=ann-room&avatar=ann-avatar", tokens["ann"])
        async with ann, Client(f"{server.url}?room=bob-room&avatar=bob-avatar", tokens["bob"]) as bob:
            await ann.render(eyes(64))
            for _ in range(2):  # the newest picture is another one
                await bob.render(eyes(64))
            marks = [stream.session.status()["mark"] for stream in server.clients.values()]
            pictures = [await server.feature(Previews).small(number) for number in (1, 2)]
            assert pictures[0] != pictures[1]
            digest = server.feature(SplatFiles).file_digest("ann-avatar")
            held = server.feature(SplatFiles)._files["ann-avatar"]
            assert digest is not None and held is not None
            facts = {
                "scene": b'"scene-avatar"', "scene-file": b"scene-file.glb", "made": MADE.encode(),
                "job": job.name.encode(), "ann-name": b'"ann"', "ann-splats": held.data, "ann-avatar": b"ann-avatar",
                "ann-room": b"ann-room", "bob-avatar": b"bob-avatar", "bob-room": b"bob-room",
                "ann-mark": marks[0].encode(), "bob-mark": marks[1].encode(), "bob-name": b'"bob"',
                "ann-picture": pictures[0], "bob-picture": pictures[1],
            }  # fmt: skip
            yield World(server, http, tokens, facts, {"job": job.name, "ann_splats": digest.hex()})


def led(folder: Path) -> StudyLead:
    study, plan = planned(folder)
    return StudyLead(Live(study, plan, 1, folder / "data"), {"fast": "ann-avatar", "slow": "bob-avatar"})


def routes(server: Server) -> set[str]:
    """What the router leads to. A GET answers HEAD, too."""
    assert server._runner is not None and server._runner.app is not None
    found = set()
    for route in server._runner.app.router.routes():
        assert route.resource is not None
        found.add(f"{route.method} {route.resource.canonical}")
    heads = {one for one in found if one.startswith("HEAD")}
    assert {one.replace("HEAD", "GET") for one in heads} <= found
    return found - heads


async def test_every_address_has_a_row(tmp_path: Path) -> None:
    """Of a server with everything. Who adds an address says here what each kind of account finds there."""
    everything: dict[str, Any] = {"rooms": {"ann-room": 4}, "webtransport": True, "video": True}
    async with running(ServerConfig(port=0, **everything), tmp_path, True, led(tmp_path)) as server:
        assert routes(server) == {row.route for row in TABLE} | STUDY
    async with world(tmp_path) as here:
        assert routes(here.server) == {row.route for row in TABLE}


async def test_what_each_account_finds(tmp_path: Path) -> None:
    """HEAD tells no more than GET, and no cache on the way keeps what depends on who asks."""
    wrong = []
    async with world(tmp_path) as here:
        for row in TABLE:
            # whoever may do more comes last: what is deleted is not there for the others
            for visitor in sorted(VISITORS, key=lambda one: row.of(one) != row.usual):
                status, headers, body = await here.ask(visitor, row.method, row.address)
                got = " ".join(map(str, [status, *sorted(here.told(body))]))
                expected, *facts = row.of(visitor).split()
                if got != " ".join([expected, *sorted(facts)]):
                    wrong.append(f"{row.route} {row.address} {visitor}: {got}, not {row.of(visitor)}")
                if row.method == "GET" and row.route != "GET /ws":
                    head, names, nothing = await here.ask(visitor, "HEAD", row.address)
                    assert head == status and nothing == b"" and not here.told(str(names).encode()), (visitor, row)
                    if row.route not in PUBLIC and visitor in ACCOUNTS:
                        kept = headers["Cache-Control"]
                        static = row.route in ("GET /motions/{name}", "GET /recording")  # of the package
                        assert "no-store" in kept or "private" in kept or (static and kept == "no-cache"), (row, kept)
                        assert "Accept-Ranges" not in headers
    assert wrong == []


async def test_what_is_not_theirs_reads_like_what_is_not_there(tmp_path: Path) -> None:
    """Status, headers and every byte."""
    count = 0
    async with world(tmp_path) as here:
        for row in TABLE:
            for visitor in ACCOUNTS:
                if not row.absent or row.of(visitor).split()[0] != row.usual:
                    continue
                for method in {row.method, "HEAD"} if row.method == "GET" else {row.method}:
                    theirs = await here.ask(visitor, method, row.address)
                    absent = await here.ask(visitor, method, row.absent)
                    assert theirs == absent, (visitor, method, row.address)
                    count += 1
    assert count > 60


@pytest.mark.parametrize("private", [False, True])
async def test_who_has_the_token_sees_all_but_of_a_private_server(tmp_path: Path, private: bool) -> None:
    """Who is who, what they see and who is in a room is nobody's there; how many they are is no secret."""
    config = ServerConfig(
        port=0, access=Access(token=TOKEN), rooms={"ann-room": 4}, private=private, limits=UNGUARDED,
        session=SessionConfig(watermark=new_watermark()),
    )  # fmt: skip
    async with running(config, tmp_path) as server, aiohttp.ClientSession() as http:
        async with Client(f"{server.url}?room=ann-room&avatar=ann-avatar&name=zoe", TOKEN) as ann:
            await ann.render(eyes(64))
            (stream,) = server.clients.values()
            mark, picture = stream.session.status()["mark"].encode(), await server.feature(Previews).small(1)
            bodies, statuses = {}, {}
            for path in ("/", "/stats", "/status.json", "/metrics", "/history", "/session", "/pictures/1"):
                url = f"http://127.0.0.1:{server.port}{path}"
                async with http.get(url) as answer:
                    assert answer.status == 401
                async with http.get(url, headers={"Authorization": f"Bearer {TOKEN}"}) as answer:
                    statuses[path], bodies[path] = answer.status, await answer.read()
    shown = [path for path in bodies if b"zoe" in bodies[path]], [path for path in bodies if mark in bodies[path]]
    pictured = [path for path in bodies if picture in bodies[path] or base64.b64encode(picture) in bodies[path]]
    assert shown == (([], []) if private else (["/stats", "/status.json"],) * 2)
    assert pictured == ([] if private else ["/status.json", "/pictures/1"])
    assert statuses["/pictures/1"] == (404 if private else 200)
    assert b'"connected": 1' in bodies["/stats"] and b'"people": 1' in bodies["/session"]
    assert (b"ann-avatar" in bodies["/stats"]) is not private and b"ann-avatar" in bodies["/session"]


async def test_a_websocket_tells_of_others_in_the_same_room_alone(tmp_path: Path) -> None:
    """Answers in pictures and in poses, and every error: names and avatars of those one meets, nothing else."""
    wrong = ["", "{", "[]", '{"v": 1}', '{"v": 9, "frame_id": 1}', '{"v": 1, "frame_id": 2, "eyes": []}']
    found = {}
    async with world(tmp_path) as here:
        for visitor, query in (("bob", "avatar=bob-avatar"), ("all", "avatar=ann-avatar&room=ann-room")):
            headers, said = {"Authorization": f"Bearer {here.tokens[visitor]}"}, b""
            async with here.http.ws_connect(f"{here.server.url}?{query}", headers=headers) as ws:
                answered = [native(1), native(2, want="pose"), native(3, want="pose", ack=2)]
                for message in [*answered, *wrong]:
                    await ws.send_str(message)
                    heard = await ws.receive(HANG)
                    said += heard.data if isinstance(heard.data, bytes) else str(heard.data).encode()
            found[visitor] = here.told(said)
    assert found == {"bob": {"bob-name"}, "all": {"ann-name", "ann-avatar", "ann-room"}}


async def test_nobody_is_everybody_only_where_there_are_no_accounts(tmp_path: Path) -> None:
    """An address that forgets to ask whose it is tells nothing."""
    async with world(tmp_path) as here:
        stats, offer = here.server.stats(), here.server.session()
        assert stats["clients"] == stats["rooms"] == offer["avatars"] == offer["rooms"] == []
        assert stats["connected"] == 2 and stats["scene"] is None
