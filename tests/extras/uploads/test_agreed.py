"""What is made of a photograph has a record of the server's own; accounts own what they had made."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import aiohttp
import pytest

from apps.serve.agreed import signing
from apps.serve.wiring import assemble
from glsplat.errors import ProtocolError
from glsplat.extras.accounts.users import Accounts, new_user, write_users
from glsplat.extras.consent.file import on_file
from glsplat.extras.consent.keys import private_key
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.extras.uploads.job import UploadConfig
from glsplat.extras.uploads.routes import Uploads
from glsplat.formats import save
from glsplat.formats.scene_file import SceneFile
from glsplat.net.client import Client
from glsplat.net.guard.access import Access
from glsplat.net.served_scene import ServedScene
from glsplat.net.server import ServerConfig
from tests.extras.uploads.conftest import described
from tests.extras.uploads.makers import PICTURE, make
from tests.scenes import limb


@pytest.fixture
def made(tmp_path, state):
    """A server's configuration of uploads, its policy, and two accounts of which each may drive nothing by its list."""
    accounts = {name: new_user(name, []) for name in ("ann", "bob")} | {"boss": new_user("boss")}
    write_users(tmp_path / "users.json", {name: user for name, (user, _) in accounts.items()})
    policy = ConsentPolicy(trusted=[])
    uploads = signing(UploadConfig(folder=tmp_path / "avatars", make=make, nice=0), policy)
    config = ServerConfig(port=0, access=Access(accounts=Accounts(tmp_path / "users.json")))
    return uploads, policy, config, {name: token for name, (_, token) in accounts.items()}


async def test_whoever_had_it_made_drives_and_deletes_it_alone(serve, made, state):
    uploads, policy, config, tokens = made
    uploads.folder.mkdir()
    async with (
        serve(config=replace(config, consent=policy), features=[Uploads(uploads, described)]) as server,
        aiohttp.ClientSession() as http,
    ):

        async def ask(method, path, who, data=None):
            headers = {"Authorization": f"Bearer {tokens[who]}", "Content-Type": "image/jpeg"}
            url = f"http://127.0.0.1:{server.port}{path}"
            async with http.request(method, url, headers=headers, data=data) as answer:
                return answer.status, await answer.json() if answer.content_type == "application/json" else None

        name = (await ask("POST", "/avatars?consent=yes", "ann", PICTURE))[1]["name"]
        while (await ask("GET", f"/avatars/{name}", "ann"))[1]["state"] != "done":
            await asyncio.sleep(0.05)
        async with Client(server.url, tokens["ann"], avatar=name):
            pass
        for who, offered in (("bob", []), ("boss", []), ("ann", [name])):
            assert [one["name"] for one in (await ask("GET", "/session", who))[1]["avatars"]] == offered
        for who in ("bob", "boss"):
            with pytest.raises(ProtocolError, match="403"):
                await Client(server.url, tokens[who], avatar=name).connect()
            assert (await ask("DELETE", f"/avatars/{name}", who))[0] == 404
        found = on_file(uploads.folder / f"{name}.glb")
        assert (await ask("DELETE", f"/avatars/{name}", "ann"))[0] == 204
    consent, key = found.consent, state / "glsplat" / "consent-key"
    assert found.fault == "" and consent.given_by == "ann" and consent.drivers == {"ann"}
    assert consent.key == private_key(key).public and key.stat().st_mode & 0o777 == 0o600
    assert 364 < (consent.ends - consent.begins) / 86400 < 367


def test_what_lies_there_without_a_record_is_left_out_with_a_line(tmp_path, made, caplog):
    uploads, policy, config, _ = made
    uploads.folder.mkdir()
    save(limb(20), uploads.folder / "old.glb")
    (uploads.folder / "new.glb").write_bytes(uploads.signed("new", (uploads.folder / "old.glb").read_bytes(), ""))
    server = assemble(ServedScene(file=SceneFile.of(limb(20))), config, uploads=uploads, consent=policy)
    assert server.catalogue.names == ("default", "new")
    assert [("old.glb: skipped" in line, line.count("\n")) for line in caplog.messages[:1]] == [(True, 0)]
    assert not any("consent" in line for line in caplog.messages[1:])
    shown = ConsentPolicy(without=True)
    server = assemble(ServedScene(file=SceneFile.of(limb(20))), config, uploads=uploads, consent=shown)
    assert set(server.catalogue.names) == {"default", "new", "old"} and shown.label("old") == "no consent on file"
