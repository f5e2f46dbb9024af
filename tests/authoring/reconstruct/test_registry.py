"""Reconstructors by name: the project's own, entry points of other packages, and what is wrong with those."""

from __future__ import annotations

from importlib.metadata import EntryPoint, EntryPoints

import pytest

from glsplat.authoring.reconstruct import plugins, registry
from glsplat.errors import GlsplatError
from tests.authoring.reconstruct.stubs import Plain

HERE = "tests.authoring.reconstruct.stubs"


@pytest.fixture
def installed(monkeypatch):
    """Entry points as if packages had brought them."""

    def install(**values: str | list[str]) -> None:
        entries = EntryPoints(
            EntryPoint(name, value, registry.GROUP)
            for name, several in values.items()
            for value in ([several] if isinstance(several, str) else several)
        )
        monkeypatch.setattr(plugins, "entry_points", lambda **which: entries.select(**which))

    return install


def test_others_are_found_and_ours_cannot_be_taken(installed) -> None:
    installed(other=f"{HERE}:Plain", builtin="nowhere:nothing", lhm="nowhere:nothing")
    assert registry.names() == ("builtin", "lhm", "other")
    assert isinstance(registry.named("other"), Plain)
    with pytest.raises(GlsplatError, match="GLSPLAT_LHM"):
        registry.named("lhm")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("nowhere:nothing", r'"other" \(nowhere:nothing\) does not load: ModuleNotFoundError: No module named'),
        (f"{HERE}:Nothing", "does not load: AttributeError"),
        (f"{HERE}:small_avatar", 'has no method "reconstruct"'),
        ("json:loads", "does not load: TypeError"),
        ([f"{HERE}:Plain", f"{HERE}:Detailed"], r'several packages have a reconstructor "other" \(tests.*Detailed, '),
    ],
)
def test_what_is_wrong_is_one_line(installed, value, message) -> None:
    installed(other=value)
    with pytest.raises(GlsplatError, match=message) as caught:
        registry.named("other")
    assert "\n" not in str(caught.value)


def test_unknown_names_list_the_known(installed) -> None:
    installed()
    with pytest.raises(GlsplatError, match=r'no reconstructor is called "lmh"; there are builtin, lhm$'):
        registry.named("lmh")
