"""The page's questionnaire, in Node, against a server that has enough of its answers."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from glsplat.extras.study.serving import live
from tests.extras.study.serving.client import TOKEN, Client, run
from tests.in_node import write_modules
from tests.needs import program, require

pytestmark = pytest.mark.check

SCRIPT = Path(__file__).with_name("questions_page.mjs")


async def answering(client: Client, folder: Path, values: list[int]) -> dict[str, Any]:
    """What the page says once it has given these answers to one item, one after the other."""
    require("node")
    write_modules(folder / "page")
    origin, secret = f"http://127.0.0.1:{client.server.port}", client.lead.secrets["participant"]
    words = [(folder / "page" / "study").as_uri(), origin, secret, TOKEN, json.dumps(values)]
    process = await asyncio.create_subprocess_exec(program("node"), str(SCRIPT), *words, stdout=asyncio.subprocess.PIPE)
    out, _ = await process.communicate()
    assert process.returncode == 0
    return json.loads(out)


def test_the_page_keeps_what_has_to_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """429: it says so, waits as long as the server asks for, and loses nothing."""
    monkeypatch.setattr(live, "BURST_BYTES", 300)
    monkeypatch.setattr(live, "RATE_BYTES_S", 150.0)

    async def test(client: Client) -> None:
        await client.begin()
        said = await answering(client, tmp_path, [5, 10, 15, 20, 25])
        assert said["answers"] == {"mental": 25} == (await client.state())["answers"]
        assert said["unsaved"] == [] and said["refused"] == 0
        assert "answers arrive faster than they can be saved" in said["troubles"][0]
        assert 5 < said["sent"] < 25  # it does not hammer
        assert client.log().count("answer") == 5

    run(tmp_path, test)
