"""A running study is private: what strangers, the participant and another participant hear of it."""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from glsplat.extras.consent.file import OnFile
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.extras.study.serving.lead import HEADER
from glsplat.net import rights
from tests.extras.accounts.test_accounts import WS
from tests.extras.accounts.test_who_sees_what import routes
from tests.extras.study.serving.client import OTHER, PAGE, TOKEN, Client, Clock, run, served, serving, until
from tests.net.wire import native

PUBLIC = ("/healthz", "/vr", "/vr/{path}")
AUTHORIZED = {"Authorization": f"Bearer {TOKEN}"}
PARTIAL = {"Range": "bytes=0-9", "If-None-Match": "*"}  # requests for a part, and for what is known already
WORDS = [b"fast", b"slow", b"avatar-", b"delay", b"light", b"old", b"young", b"-movement", b"nasa"]
"""What tells of the design, the condition or the order: names of conditions, avatars, factors, questionnaires."""


def paths(client: Client) -> set[tuple[str, str]]:
    """(method, path) of every address, also of HEAD and of what is not there."""
    found = {("GET", "/nowhere"), ("GET", "/study/picture"), ("PUT", "/stats")}
    for route in routes(client.server):
        method, address = route.split()
        if address in PUBLIC or address.startswith("/study/"):
            continue
        for name in ("1", "avatar-fast", "idle", "of-nobody"):
            path = address.replace("{number}", "1").replace("{name}", name).replace("{sha256}", name)
            found |= {(method, path), ("HEAD", path)} if method == "GET" else {(method, path)}
    return found


async def ask(client: Client, method: str, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    url = f"http://127.0.0.1:{client.server.port}{path}"
    async with client.http.request(method, url, headers=AUTHORIZED | headers) as answer:
        told = {name: value for name, value in answer.headers.items() if name != "Date"}
        return answer.status, told, b"" if answer.status == 101 else await answer.read()


async def to_the_task(client: Client) -> None:
    """The first task of the first condition runs."""
    await client.begin()
    await client.answer_all()
    state = await client.state()
    await client.do("ready", step=state["step"])


async def a_picture(client: Client) -> aiohttp.ClientWebSocketResponse:
    ws = await client.http.ws_connect(f"{client.server.url}?study={PAGE}", headers=AUTHORIZED)
    await ws.send_str(native(1))
    await ws.receive(20)
    return ws


@served()
async def test_strangers_hear_nothing_whatever_goes_on(client: Client) -> None:
    """Each address says the same, byte by byte, before the session, while a condition is shown, and after its end."""

    async def everything() -> dict[Any, Any]:
        found = {}
        for secret, more in (("", {}), ("x", PARTIAL), (client.lead.secrets["participant"], WS)):
            for method, path in sorted(paths(client)):
                found[method, path, secret] = await ask(client, method, path, **{HEADER: secret}, **more)
        return found

    before = await everything()
    assert {status for status, _, _ in before.values()} == {403}
    assert len({body for (method, *_), (_, _, body) in before.items() if method != "HEAD"}) == 1
    await to_the_task(client)
    ws = await a_picture(client)
    assert len(client.server.clients) == 1
    assert await everything() == before
    await client.post("command", {"do": "abort", "text": "the end"}, "experimenter")
    await ws.receive(20)
    await until(lambda: not client.server.clients)
    assert await everything() == before


@served()
async def test_the_experimenter_finds_everything(client: Client) -> None:
    await to_the_task(client)
    ws = await a_picture(client)
    secret = {HEADER: client.lead.secrets["experimenter"]}
    for path in ("/", "/stats", "/status.json", "/metrics", "/history", "/session", "/pictures/1"):
        assert (await ask(client, "GET", path, **secret))[0] == 200, path
    (shown,) = json.loads((await ask(client, "GET", "/stats", **secret))[2])["clients"]
    assert shown["avatar"] in ("avatar-fast", "avatar-slow")
    await ws.close()


@served()
async def test_whoever_guesses_a_page_is_not_let_in(client: Client) -> None:
    """Nor does an answer tell whether there is a page, whether something is shown, or what is offered."""
    queries = ("", "?study=", f"?study={OTHER}", f"?study={PAGE[:-1]}", "?avatar=avatar-fast", "?avatar=nobody")
    before = [await ask(client, "GET", f"/ws{query}", **WS) for query in queries]
    await to_the_task(client)
    ws = await a_picture(client)
    assert [await ask(client, "GET", f"/ws{query}", **WS) for query in queries] == before
    assert {status for status, _, _ in before} == {403} and len({body for _, _, body in before}) == 1
    assert not any(word in before[0][2] for word in WORDS)
    await ws.close()


@served(max_clients=1)
async def test_a_full_server_says_nothing_of_it(client: Client) -> None:
    """With room for one client, 503 would tell that the participant is shown something."""
    before = await ask(client, "GET", "/ws", **WS)
    await to_the_task(client)
    ws = await a_picture(client)
    assert await ask(client, "GET", "/ws", **WS) == before
    await ws.close()


def test_the_participants_page_does_not_know_the_condition(tmp_path: Path) -> None:
    """All that it is told from consent to end: how to show, by view and latency, and no name of anything else."""
    clock = Clock()

    async def test(client: Client) -> None:
        heard: list[bytes] = []

        async def do(what: str, **more: Any) -> Any:
            status, told = await client.do(what, **more)
            heard.append(json.dumps(told).encode())
            assert status == 200
            return told

        state = await do("enter")
        kinds = set()
        while not state["ended"]:
            kinds.add(state["kind"])
            assert set(state["condition"] or {}) <= {"view", "latency"}
            if state["kind"] == "consent":
                await do("consent", step=state["step"], accepted=True)
            elif state["kind"] == "questionnaire":
                for item in state["items"]:
                    value = {"choice": item["labels"][:1], "text": ["words"]}.get(item["kind"], [item.get("from")])[0]
                    await do("answer", step=state["step"], item=item["name"], value=value)
                await do("submit", step=state["step"])
            elif state["phase"] == "instruction" and state["ready"]:
                await do("ready", step=state["step"])
            clock.now += 1.5  # less than the rest, and than a page may be silent
            await asyncio.sleep(0.12)
            state = await client.state()
            heard.append(json.dumps(state).encode())
        assert kinds == {"consent", "questionnaire", "task", "rest"} and state["ended"] == "done"
        for word in WORDS:
            assert not [text for text in heard if word in text.lower()], word

    run(tmp_path, test, clock=clock)


def test_errors_name_no_avatar_either(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not where the page asks for others, and not where the consent ends while it is shown."""

    class Ended(ConsentPolicy):
        over = False

        def refusal(self, avatar: str, driver: str, now: float) -> str | None:
            return f'"{avatar}": its consent ended' if self.over else None

    policy = Ended()
    for name in ("avatar-fast", "avatar-slow"):
        policy.add(name, [OnFile(nobody=True)])
    monkeypatch.setattr(rights, "time", time)

    async def test(client: Client) -> None:
        await to_the_task(client)
        for query in ("avatar=nobody", "avatar=avatar-slow&room=x&name=.&at=y&label=z"):
            url = f"{client.server.url}?study={PAGE}&{query}"
            async with client.http.ws_connect(url, headers=AUTHORIZED):
                (stream,) = client.server.clients.values()
                assert stream.shown.name == client.lead._avatars[client.live.condition.name]
                assert stream.member is None
            await until(lambda: not client.server.clients)
        wrong = await ask(client, "GET", f"/ws?study={PAGE}&height=tall", **WS)
        ws = await a_picture(client)
        policy.over = True
        await ws.send_str(native(2))
        told = (await ws.receive(20)).data.encode()
        refused = await ask(client, "GET", f"/ws?study={PAGE}", **WS)
        assert wrong[0] == 400 and refused[0] == 403 and b"experimenter" in told and b"experimenter" in refused[2]
        assert not any(word in text for word in WORDS for text in (told, refused[2], wrong[2]))

    run(tmp_path, test, consent=policy)


def test_one_participant_is_nobody_at_anothers_server(tmp_path: Path) -> None:
    """Of the same study, in the same folder: neither secrets nor the page's name lead anywhere."""

    async def main() -> None:
        async with serving(tmp_path) as first, serving(tmp_path, participant=2) as second:
            await to_the_task(first)
            await second.begin()
            for own, other in ((first, second), (second, first)):
                for path in ("state", "do", "watch", "command", "picture"):
                    for who in ("participant", "experimenter"):
                        message = {"do": "enter", "page": OTHER}
                        status, told = await other.post(path, message, secret=own.lead.secrets[who])
                        assert (status, told["error"]["code"]) == (403, "not_allowed")
                        assert not any(word in json.dumps(told).encode() for word in WORDS)
                for who in ("participant", "experimenter"):
                    assert (await ask(other, "GET", "/stats", **{HEADER: own.lead.secrets[who]}))[0] == 403
            assert first.live.page == second.live.page == PAGE  # made up by each page, and here by the test
            assert (await ask(second, "GET", f"/ws?study={OTHER}", **WS))[0] == 403
            logs = [(tmp_path / f"data/sub-00{number}/session.jsonl").read_text() for number in (1, 2)]
            assert logs[0] != logs[1]

    asyncio.run(main())
