"""A version of aioquic without the parts that are used gives one clear line, and one module uses them."""

from __future__ import annotations

import ast
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

pytest.importorskip("aioquic", reason="aioquic (glsplat[webtransport]) is not installed")

from aioquic.quic.congestion import base
from aioquic.quic.connection import QuicConnection
from aioquic.quic.recovery import QuicPacketPacer

from apps.cli import main
from glsplat.extras.far_links import datagrams

FOLDER = Path(datagrams.__file__).parent
ADAPTER = "aioquic_internals"
# of the modules that aioquic's documentation describes
DOCUMENTED = {"aioquic.h3.connection", "aioquic.h3.events", "aioquic.quic.configuration", "aioquic.quic.events"}


@pytest.mark.parametrize("part", ["register_congestion_control", "QuicPacketPacer.update_rate", "QuicConnection._loss"])
def test_another_aioquic_is_refused_in_a_line(
    part: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if part == "QuicConnection._loss":
        monkeypatch.setattr(QuicConnection, "__init__", lambda self: None)
        monkeypatch.setattr(QuicConnection, "_datagrams_pending", [], raising=False)
    else:
        monkeypatch.delattr(QuicPacketPacer if "." in part else base, part.rpartition(".")[2])
    for name in (ADAPTER, "congestion", "listener", "path"):  # imported anew
        monkeypatch.delitem(sys.modules, f"{datagrams.__name__}.{name}", raising=False)
    options = tmp_path / "server.toml"
    options.write_text("webtransport = true\n")
    assert main(["serve", "--port", "0", "--config", str(options)]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert part in line and "expects aioquic 1.7" in line and f"got version {version('aioquic')}" in line
    assert "pip install 'aioquic>=1.7.2,<1.8'" in line


def test_the_requirement_is_that_of_the_pip_extra() -> None:
    from glsplat.extras.far_links.datagrams.aioquic_internals import PACKAGE

    setup = tomllib.loads((FOLDER.parents[3] / "pyproject.toml").read_text())
    assert setup["project"]["optional-dependencies"]["webtransport"] == [PACKAGE]


def test_one_module_touches_undocumented_parts() -> None:
    from glsplat.extras.far_links.datagrams.aioquic_internals import _PARTS

    private = {name for names in _PARTS.values() for name in names if name.startswith("_")} - {"_loop"}
    for path in FOLDER.glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
        touched = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)} & private
        undocumented = {name for name in imported if name.startswith("aioquic")} - DOCUMENTED
        assert path.stem == ADAPTER or not (undocumented | touched), path.name
