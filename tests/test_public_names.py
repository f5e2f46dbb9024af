"""What is public: the names that the root, each sub-package and each module right in glsplat/ has in its __all__."""

from __future__ import annotations

import ast
import importlib
import re

import pytest

import glsplat
from tests.test_layers import FILES, ROOT

pytestmark = pytest.mark.check

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
PROGRAMS = sorted((ROOT / "docs" / "examples").glob("*.py"))
BLOCK = re.compile(r"^```(?:python|pycon)\n(.*?)^```", re.M | re.S)


def public_of(module: str) -> tuple[str, ...]:
    return tuple(getattr(importlib.import_module(module), "__all__", ()))


def is_public(module: str) -> bool:
    """A package, a module right in glsplat/, or one that its package's ``__all__`` names."""
    path, package, name = FILES[module], *module.rpartition(".")[::2]
    return path.name == "__init__.py" or package == "glsplat" or name in public_of(package)


def private_names(code: str) -> list[str]:
    """What a program imports of glsplat that nobody made public."""
    out = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            out += [alias.name for alias in node.names if alias.name.startswith("glsplat.")]
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "glsplat":
            public = public_of(node.module) if is_public(node.module) else ()
            out += [f"{node.module}.{alias.name}" for alias in node.names if alias.name not in public]
    return out


def programs() -> dict[str, str]:
    blocks = {page.name: "\n".join(BLOCK.findall(page.read_text(encoding="utf-8"))) for page in PAGES}
    return blocks | {program.name: program.read_text(encoding="utf-8") for program in PROGRAMS}


def test_docs_import_what_is_public() -> None:
    found = programs()
    assert sum("glsplat" in code for code in found.values()) > 8
    assert not {name: lost for name, code in found.items() if (lost := private_names(code))}


def test_the_rule_can_fail() -> None:
    assert private_names("from glsplat.net import Client\nfrom glsplat import load\nimport glsplat") == []
    assert private_names("from glsplat.watermark.detect import detect") == []  # the package names that module
    for name in ("net.flow.FlowControl", "camera._length", "formats.gltf.container.parse", "tracking.solve.quat.mul"):
        module, _, leaf = f"glsplat.{name}".rpartition(".")
        assert private_names(f"def f():\n    from {module} import {leaf}") == [f"glsplat.{name}"]
    assert private_names("import glsplat.net.client") == ["glsplat.net.client"]


def test_what_is_public_is_there() -> None:
    """Every name of every ``__all__`` can be had, and no name hides a module of its package."""
    packages = [name for name, path in FILES.items() if path.name == "__init__.py" and name.split(".")[0] == "glsplat"]
    said = {name: module for name in packages if hasattr(module := importlib.import_module(name), "_HOME")}
    assert glsplat in said.values() and len(said) > 8
    for name, module in said.items():
        hidden = [one for one in module._HOME if f"{name}.{one}" in FILES]
        assert not hidden, f"{name} has a module and a name {hidden}"
        for one in module.__all__:
            assert getattr(module, one, None) is not None or f"{name}.{one}" in FILES, f"{name} lacks {one}"


def test_a_package_says_its_names_once() -> None:
    for path in (ROOT / "glsplat").rglob("__init__.py"):
        text = path.read_text(encoding="utf-8")
        assert "def __getattr__" not in text, f"{path}: on_demand of the root does that"
