"""Numbers in README and docs that code knows: a page whose copy is old fails."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import glsplat
from apps import cli
from apps.serve.options import add_options
from glsplat.data import person
from glsplat.extras.authoring.reconstruct import Options
from glsplat.extras.evaluate.comparison import own_methods
from glsplat.extras.study.questionnaires import embedded
from glsplat.skinning.expression import ARKIT

pytestmark = [pytest.mark.check, pytest.mark.gl]

ROOT = Path(__file__).resolve().parents[1]
NUMBERS = {"three": 3, "ten": 10, "eleven": 11}


def flags_of_serve() -> int:
    parser = argparse.ArgumentParser(add_help=False)
    add_options(parser)
    return sum(1 for action in parser._actions if action.option_strings)


def bytes_of(scene: glsplat.Splats | glsplat.Avatar) -> int:
    count = len(scene.splats if isinstance(scene, glsplat.Avatar) else scene)
    with glsplat.Renderer(scene, size=(16, 16), views=2) as renderer:
        renderer.render(glsplat.stereo_cameras(np.eye(4), ipd=0.06, size=(16, 16)))
        sizes = renderer.nbytes()
    return round((sum(sizes.values()) - sizes["targets"]) / count)


def static_bytes() -> int:
    n = 10240  # whole rows of 1024 splats
    means = np.random.default_rng(0).normal(size=(n, 3))
    turns, sizes = np.tile([1, 0, 0, 0], (n, 1)), np.full((n, 3), 0.01)
    return bytes_of(glsplat.Splats.create(means, turns, sizes, np.full(n, 0.9), rgb=np.full((n, 3), 0.5)))


CLAIMS: list[tuple[str, str, Callable[[], int]]] = [
    ("docs/performance.md", r"counts (\d+) bytes a splat for a static scene", static_bytes),
    ("docs/performance.md", r"surface,\s+takes (\d+)\.", lambda: bytes_of(person("anna"))),
    ("docs/frame.md", r"in two views takes (\d+) bytes", static_bytes),
    ("docs/gallery.md", r"^(\w+) programs of fewer", lambda: len(list((ROOT / "docs/examples").glob("*.py")))),
    ("docs/photo.md", r"steps of the fit \((\d+), half a minute\)", lambda: Options().steps),
    ("docs/photo.md", r"`--splats N`, `--seed N` \| (\d+) and 0", lambda: Options().splats),
    ("docs/evaluation.md", r"fitted for (\d+) steps \(60 without", lambda: own_methods._STEPS),
    ("docs/faces.md", r"## The (\d+) shapes", lambda: len(ARKIT)),
    ("CHANGELOG.md", r"has SCENE and (\d+) flags", flags_of_serve),
]


@pytest.mark.parametrize(("page", "pattern", "true"), CLAIMS, ids=[f"{page}: {text}" for page, text, _ in CLAIMS])
def test_a_number_is_that_of_the_code(page: str, pattern: str, true: Callable[[], int]) -> None:
    found = re.search(pattern, (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None, f"{page} has no {pattern!r} any more: change the claim here"
    word = found[1].lower()
    assert NUMBERS[word] if word in NUMBERS else int(word) == true()


def test_every_command_has_its_place_in_the_docs() -> None:
    page = (ROOT / "docs/commands.md").read_text(encoding="utf-8")
    assert [name for name in cli.COMMANDS if f"`glsplat {name}" not in page] == []


def test_the_questionnaires_of_the_docs_are_those_of_the_package() -> None:
    page = (ROOT / "docs/study.md").read_text(encoding="utf-8")
    section = page.partition("## Questionnaires")[2].partition("\n## ")[0]
    rows = [cell for line in section.splitlines() if line.startswith("| `") for cell in line.split("|")[1:2]]
    named = {name for cell in rows for name in re.findall(r"`([\w-]+)`", cell)}
    assert named == set(embedded())
