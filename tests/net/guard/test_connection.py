"""connection.py overrides methods of aiohttp's request handler: they are still those that it was written for."""

from __future__ import annotations

import inspect
import re
import tomllib
from pathlib import Path

import aiohttp
import pytest
from aiohttp import web

from glsplat.net.guard.connection import GuardedConnection

CHECK = "look at glsplat/net/guard/connection.py, run tests/net/guard and tests/net/attacks, then raise the bound"
THEIRS = {
    "connection_made": ["self", "transport"],
    "data_received": ["self", "data"],
    "start": ["self"],
    "connection_lost": ["self", "exc"],
    "set_parser": ["self", "parser", "data_received_cb"],
    "handle_error": ["self", "request", "status", "exc", "message"],
    "log_exception": ["self", "args", "kw"],
}


def test_aiohttp_is_one_that_the_connection_was_tested_with() -> None:
    setup = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())
    (wanted,) = [one for one in setup["project"]["dependencies"] if one.startswith("aiohttp")]
    found = re.fullmatch(r"aiohttp>=([\d.]+),<([\d.]+)", wanted)
    assert found is not None, f"{wanted}: an upper bound is needed"
    version, low, high = (tuple(map(int, one.split("."))) for one in (aiohttp.__version__, *found.groups()))
    assert low <= version < high, f"aiohttp {aiohttp.__version__}: {CHECK}"


@pytest.mark.parametrize("name", THEIRS)
def test_what_is_overridden_is_there_and_takes_the_same(name: str) -> None:
    assert name in vars(GuardedConnection)
    for kind in (web.RequestHandler, GuardedConnection):
        assert list(inspect.signature(getattr(kind, name)).parameters) == THEIRS[name], f"{kind}: {CHECK}"
