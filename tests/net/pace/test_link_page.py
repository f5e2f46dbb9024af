"""The page's half of fitting pictures to links, in Node: what its connection says of what arrived."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from glsplat.net.messages import Ack, Decoder
from tests.in_node import write_modules
from tests.needs import program, require
from tests.net.wire import EYE

pytestmark = pytest.mark.check

SCRIPT = Path(__file__).with_name("link_page.mjs")


def test_the_page_says_once_how_each_picture_arrived(tmp_path: Path) -> None:
    """With a message that acknowledges where requests wait, else with the next request; the server reads them all."""
    require("node")
    connection = (write_modules(tmp_path) / "stream" / "connection.js").as_uri()
    done = subprocess.run([program("node"), str(SCRIPT), connection], stdout=subprocess.PIPE, check=True)
    sent = json.loads(done.stdout)
    assert [message.get("frame_id") for message in sent] == [1, 2, None, 3, 4, 5]
    assert [message["ack"] for message in sent] == [0, 0, 1, 1, 3, 3]
    arrivals = [message.get("arrival") for message in sent]
    assert [arrival is not None for arrival in arrivals] == [False, False, True, False, True, False]
    assert arrivals[2]["age"] >= 29 and 0 <= arrivals[2]["held"] < arrivals[2]["age"]
    for message in sent:
        request = Decoder().decode(json.dumps(message | ({"eyes": [EYE]} if "frame_id" in message else {})))
        told = message.get("arrival")
        assert (request.arrival is None) == (told is None)
        assert told is None or request.arrival.age == told["age"]
        assert isinstance(request, Ack) == ("frame_id" not in message)
