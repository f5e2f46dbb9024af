"""A session that cannot be opened at once: it begins when the disk has room again, without a new server."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from glsplat.errors import FormatError
from glsplat.study.session import Event
from glsplat.study.store import Store
from tests.study.serving.client import Client, run


def test_a_disk_that_was_full_at_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    append, full = Store.append, [True]

    def tried(self: Store, events: Sequence[Event]) -> None:
        if full[0]:
            raise FormatError(f"{self.folder}: No space left on device")
        append(self, events)

    monkeypatch.setattr(Store, "append", tried)

    async def test(client: Client) -> None:
        for _ in range(2):
            status, said = await client.do("enter")
            assert status == 507 and str(tmp_path) not in str(said)
        assert "No space left" in str((await client.post("watch", {}, "experimenter"))[1])
        full[0] = False
        await client.begin()
        assert client.log().count("open") == 1 and client.log()[-1] == "begin"

    run(tmp_path, test)
