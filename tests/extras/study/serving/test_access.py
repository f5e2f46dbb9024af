"""A study's server, from outside: who may do what, and what a hostile page gets."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import aiohttp

from glsplat.net.guard.limits import Limits
from tests.extras.study.serving.client import OTHER, PAGE, Client, run, served, until


@served()
async def test_nobody_without_their_own_secret(client: Client) -> None:
    for path in ("state", "do", "watch", "command", "picture"):
        needed = "participant" if path in ("state", "do") else "experimenter"
        other = "experimenter" if needed == "participant" else "participant"
        for secret in ("", "x", "é", client.lead.secrets[other], client.lead.secrets[needed][:-1]):
            status, said = await client.post(path, {"do": "enter", "page": PAGE}, secret=secret)
            assert (status, said["error"]["code"]) == (403, "not_allowed")
    await until(client.log)  # the session is opened beside the first requests
    assert client.log() == ["open", "begin"]
    async with client.http.post(f"http://127.0.0.1:{client.server.port}/study/do", json={}) as answer:
        assert answer.status == 401  # the server's own token comes first


@served(limits=Limits(visits=0.001))
async def test_a_quick_participant_does_not_keep_the_experimenter_out(client: Client) -> None:
    """Of one address: what comes with a secret costs as much as a file of the page, what guesses one a whole visit."""
    await client.begin()
    for count in range(60):
        assert (await client.post("command", {"do": "note", "text": f"{count}"}, "experimenter"))[0] == 200
        assert (await client.post("state", {"page": PAGE, "after": -1}))[0] == 200
    guesses = 0
    while (await client.post("watch", {}, secret="x"))[0] == 403:
        guesses += 1
    assert guesses < 50 - 0.1 * 120


@served()
async def test_a_hostile_page_changes_nothing(client: Client) -> None:
    """Wrong steps, answers out of range, of other kinds, after the end, a megabyte, and all of it twice."""
    await client.begin()
    before = client.log()
    step = "002-questionnaire"
    wrong = [
        *[
            ("answer", {"step": step, "item": "mental", "value": v}, 422)
            for v in (-5, 3, 105, "5", None, True, [5], {"x": 5})
        ],
        ("answer", {"step": step, "item": "__class__", "value": 5}, 422),
        ("answer", {"step": step, "item": ["mental"], "value": 5}, 422),
        ("answer", {"step": "011-questionnaire", "item": "sex", "value": "one"}, 409),
        ("answer", {"step": "../002-questionnaire", "item": "mental", "value": 5}, 409),
        ("submit", {"step": step}, 422),
        ("ready", {"step": step}, 409),
        ("consent", {"step": step, "accepted": True}, 409),
        ("consent", {"step": "001-consent", "accepted": "yes"}, 400),
        ("pause", {"step": step}, 400),
        ("abort", {"step": step}, 400),
    ]
    for what, more, expected in wrong * 2:
        status, said = await client.do(what, **more)
        assert status == expected and set(said["error"]) == {"code", "message"}, (what, more)
    assert (await client.do("consent", step="001-consent", accepted=False))[0] == 200  # it is past: nothing changes
    assert (await client.do("answer", OTHER, step=step, item="mental", value=5))[0] == 409
    for size in (50_000, 1_000_000):
        try:
            status, _ = await client.do("answer", step=step, item="mental", value="x" * size)
        except aiohttp.ClientError:
            status = 0  # cut off
        assert status in (0, 400, 413)
    messages = [
        b"",
        b"[]",
        b"null",
        b"{",
        b"\xff",
        b"[" * 40_000,
        b'{"do": 1}',
        b'{"do": "enter"}',
        b'{"do": "submit"}',
    ]
    for page in (7, "../../etc/passwd", "short"):
        messages.append(json.dumps({"do": "enter", "page": page}).encode())
    for message in messages:
        status, said = await client.post("do", message)
        assert status in (400, 409) and said["error"]["message"], message
    for text in ("x" * 10_001, "", 5, None, ["x"]):
        assert (await client.post("command", {"do": "note", "text": text}, "experimenter"))[0] == 422
    for what in ("delete", None, ["note"], {"a": 1}):
        assert (await client.post("command", {"do": what}, "experimenter"))[0] == 400
    assert client.log() == before
    await client.answer_all()
    assert client.log()[-2:] == ["submit", "begin"]


@served()
async def test_two_at_once_are_one_after_the_other(client: Client) -> None:
    """A hundred answers and submits at the same moment: each is written once, none after the step."""
    await client.begin()
    items = [item["name"] for item in (await client.state())["items"]]
    doing = [client.do("answer", step="002-questionnaire", item=item, value=50) for item in items * 10]
    await asyncio.gather(*doing)
    await asyncio.gather(*[client.do("submit", step="002-questionnaire") for _ in range(20)])
    kinds = client.log()
    assert kinds.count("answer") == 6 and kinds.count("submit") == 1


@served()
async def test_of_two_pages_the_newer_counts(client: Client) -> None:
    assert (await client.post("state", {"page": PAGE}))[1]["error"]["code"] == "enter"
    await client.begin()
    assert (await client.do("enter", OTHER))[0] == 200
    for path in ("state", "do"):
        status, said = await client.post(path, {"page": PAGE, "do": "submit", "step": "002-questionnaire"})
        assert (status, said["error"]["code"]) == (409, "elsewhere")
    assert (await client.do("enter"))[0] == 200
    assert (await client.do("answer", step="002-questionnaire", item="mental", value=5))[0] == 200


@served()
async def test_only_the_participants_page_is_shown_anything(client: Client) -> None:
    async def refused(query: str) -> int:
        try:
            async with client.socket(query):
                return 101
        except aiohttp.WSServerHandshakeError as error:
            return error.status

    assert await refused("") == await refused(f"?study={PAGE}") == 403
    await client.begin()
    assert await refused(f"?study={PAGE}") == 403  # a questionnaire before all conditions
    await client.answer_all()
    assert await refused("") == await refused(f"?study={OTHER}") == 403
    assert await refused(f"?study={PAGE}") == 101


def test_secrets_stay_over_a_restart(tmp_path: Path) -> None:
    found = []

    async def test(client: Client) -> None:
        found.append(client.lead.secrets)

    run(tmp_path, test)
    run(tmp_path, test)
    assert found[0] == found[1] and found[0]["participant"] != found[0]["experimenter"]
    assert (tmp_path / "data/sub-001/keys.json").stat().st_mode & 0o077 == 0
