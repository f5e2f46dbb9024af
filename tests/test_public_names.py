"""Public names: those that the root, each sub-package and each module right in glsplat/ has in its __all__."""

from __future__ import annotations

import ast
import importlib
import inspect
import re

import pytest

import glsplat
from tests.test_layers import FILES, ROOT

pytestmark = pytest.mark.check

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
PROGRAMS = [*(ROOT / "docs" / "examples").glob("*.py")]
BLOCK = re.compile(r"^```(?:python|pycon)\n(.*?)^```", re.M | re.S)


def public_of(module: str) -> tuple[str, ...]:
    return tuple(getattr(importlib.import_module(module), "__all__", ()))


def is_public(module: str) -> bool:
    """Return True for a package, a module right in glsplat/, or one that its package's ``__all__`` names."""
    path, package, name = FILES[module], *module.rpartition(".")[::2]
    return path.name == "__init__.py" or package == "glsplat" or name in public_of(package)


def private_names(code: str) -> list[str]:
    """Return what a program imports of glsplat that is not public."""
    out = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            out += [alias.name for alias in node.names if alias.name.startswith("glsplat.")]
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "glsplat":
            public = public_of(node.module) if is_public(node.module) else ()
            out += [f"{node.module}.{alias.name}" for alias in node.names if alias.name not in public]
    return out


def test_docs_import_public_names_alone() -> None:
    assert private_names("from glsplat.net.flow import FlowControl") == ["glsplat.net.flow.FlowControl"]
    for page in PAGES:
        assert not private_names("\n".join(BLOCK.findall(page.read_text(encoding="utf-8")))), page.name
    for program in PROGRAMS:
        assert not private_names(program.read_text(encoding="utf-8")), program.name


@pytest.mark.parametrize(
    "module", [name for name, path in FILES.items() if path.name == "__init__.py" and name.split(".")[0] == "glsplat"]
)
def test_public_names_exist_and_have_docstrings(module: str) -> None:
    package = importlib.import_module(module)
    for name in public_of(module):
        thing = getattr(package, name, None) or importlib.import_module(f"{module}.{name}")
        assert not callable(thing) or inspect.getdoc(thing), f"{module}.{name}"


def test_a_name_that_is_not_there() -> None:
    with pytest.raises(AttributeError, match="No glsplat attribute nonsense"):
        glsplat.nonsense  # noqa: B018
