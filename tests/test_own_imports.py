"""How much of the house an import really loads: a bare one in a process of its own."""

from __future__ import annotations

import subprocess
import sys

import pytest

import glsplat.formats
import glsplat.net
import glsplat.tracking

MOST = {  # own modules, the root among them
    "glsplat": 1,
    "glsplat.errors": 2,
    "glsplat.formats": 2,
    "glsplat.io.npz": 5,
    "glsplat.tracking": 2,
    "glsplat.tracking.sample": 6,  # the names of expressions among them
    "glsplat.net.messages": 30,
    "glsplat.net.client.client": 37,
}


def loaded(statement: str) -> set[str]:
    code = f"{statement}\nimport sys; print(*[name for name in sys.modules if name.split('.')[0] == 'glsplat'])"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


@pytest.mark.parametrize("module", MOST)
def test_an_import_loads_what_it_needs(module: str) -> None:
    found = loaded(f"import {module}")
    assert module in found and len(found) <= MOST[module], sorted(found)


@pytest.mark.parametrize(
    "package", [glsplat, glsplat.formats, glsplat.net, glsplat.tracking], ids=lambda package: package.__name__
)
def test_a_lazy_package_has_all_that_it_says(package: object) -> None:
    name, names = package.__name__, package.__all__  # type: ignore[attr-defined]
    assert set(names) == set(package._HOME)  # type: ignore[attr-defined]
    found = loaded(f"from {name} import *\nimport {name}\nfor one in {name}.__all__: getattr({name}, one)")
    assert {f"{name}.{home}" for home in package._HOME.values()} <= found  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match=f"module '{name}' has no attribute 'nonsense'"):
        package.nonsense  # type: ignore[attr-defined]  # noqa: B018
