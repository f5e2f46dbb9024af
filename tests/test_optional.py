"""Extras are found by name; an absent one is told from a broken one."""

from __future__ import annotations

import json

import pytest

from glsplat import optional
from glsplat.errors import GlsplatError
from glsplat.formats import all_formats
from glsplat.net import served_scene, session
from glsplat.net.backends import tracking
from glsplat.net.client import Client, client
from glsplat.net.messages import Decoder
from glsplat.net.options import ServerConfig

NAMES = "ply glb gltf poses scene compressed-ply splat ksplat spz sog obj npz bvh amc amass"


@pytest.mark.extra(name="formats")
@pytest.mark.extra(name="motions")
@pytest.mark.extra(name="rigs")
def test_every_format_is_registered() -> None:
    assert set(all_formats()) == set(NAMES.split())


@pytest.mark.extra(name="formats")
def test_an_absent_extra_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    assert optional.plugin("nothing.rows") is None and not optional.has_extra("nothing")
    assert optional.plugin("formats.rows") is not None

    def refuse(name: str) -> None:
        raise ModuleNotFoundError(name="glsplat.extras")

    monkeypatch.setattr(optional, "extra_module", refuse)
    assert optional.plugin("formats.rows") is None


@pytest.mark.parametrize("name", ["glsplat.extras.formats.mistyped", "brotli", None])
def test_a_broken_extra_is_an_error(monkeypatch: pytest.MonkeyPatch, name: str | None) -> None:
    def broken(_: str) -> None:
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(optional, "extra_module", broken)
    monkeypatch.setattr(optional, "has_extra", lambda name: name == "formats")
    with pytest.raises(ModuleNotFoundError):
        optional.plugin("formats.rows")


def test_what_needs_an_absent_extra_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (client, tracking):
        monkeypatch.setattr(module, "plugin", lambda name: None)
    with pytest.raises(GlsplatError, match=r"^video needs glsplat\.extras\.far_links, which is not installed$"):
        Client("ws://127.0.0.1:9/ws", video=True)
    with pytest.raises(GlsplatError, match=r"^moving idle eyes needs glsplat\.extras\.speech, which is not installed$"):
        tracking._idle_face()


@pytest.mark.extra(name="rooms")
def test_a_server_needs_the_extras_that_its_configuration_names(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(served_scene.standard_features(ServerConfig(rooms={"lab": 2}))) > 2
    monkeypatch.setattr(served_scene, "plugin", lambda name: None)
    assert [type(one).__name__ for one in served_scene.standard_features(ServerConfig())] == ["Pages"]
    for config, line in (
        (ServerConfig(rooms={"lab": 2}), "a room needs glsplat.extras.rooms"),
        (ServerConfig(webtransport=True), "WebTransport needs glsplat.extras.far_links"),
    ):
        with pytest.raises(GlsplatError, match=f"^{line}, which is not installed$"):
            served_scene.standard_features(config)


@pytest.mark.extra(name="far_links")
def test_without_far_links_pictures_do_not_follow_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = json.dumps({"v": 1, "type": "ack", "ack": 0, "arrival": {"age": 20.0, "held": 0.0}})
    for absent in (False, True):
        if absent:
            monkeypatch.setattr(session, "_link_module", lambda: None)
        one = session.Session(Decoder(), session.SessionConfig(adapt=True))
        assert one.receive(answer, 0.0) is None and one.counts.malformed == 0
        assert (one.link is None) is absent and one.rest(0.0) == 0.0


def test_a_missing_package_is_an_import_error_with_the_command() -> None:
    optional.require_package("video", "json", "video")
    with pytest.raises(ImportError, match=r"^video needs nosuch\.av: pip install 'glsplat\[video\]', or leave it out$"):
        optional.require_package("video", "nosuch.av", "video", "leave it out")


@pytest.mark.parametrize(
    ("name", "extra"),
    [
        ("glsplat.extras.nothing", "glsplat.extras.nothing"),
        ("glsplat.extras.nothing.rows", "glsplat.extras.nothing"),
        ("glsplat.extras.formats.mistyped", None),
        ("glsplat.nothing", None),
        ("brotli", None),
        (None, None),
    ],
)
def test_an_absent_extra_is_the_cause_of_a_failed_import(
    monkeypatch: pytest.MonkeyPatch, name: str | None, extra: str | None
) -> None:
    monkeypatch.setattr(optional, "has_extra", lambda name: name == "formats")
    assert optional.absent_extra(ModuleNotFoundError(name=name)) == extra
