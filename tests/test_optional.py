"""Extras are found by name; an absent one is told from a broken one."""

from __future__ import annotations

import pytest

from glsplat import optional
from glsplat.errors import GlsplatError
from glsplat.formats import all_formats
from glsplat.net.backends import tracking
from glsplat.net.client import Client, client

NAMES = "ply glb gltf poses scene compressed-ply splat ksplat spz sog obj npz bvh amc amass"


def test_every_format_is_registered() -> None:
    assert set(all_formats()) == set(NAMES.split())


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
    with pytest.raises(ModuleNotFoundError):
        optional.plugin("formats.rows")


def test_what_needs_an_absent_extra_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (client, tracking):
        monkeypatch.setattr(module, "plugin", lambda name: None)
    with pytest.raises(GlsplatError, match=r"^video needs glsplat\.extras\.far_links, which is not installed$"):
        Client("ws://127.0.0.1:9/ws", video=True)
    with pytest.raises(GlsplatError, match=r"^moving idle eyes needs glsplat\.extras\.speech, which is not installed$"):
        tracking._idle_face()
