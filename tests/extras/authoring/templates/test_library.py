"""The library of templates: every one loads, is on the open body, and has its licence beside it."""

from __future__ import annotations

from importlib import resources

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.templates.library import HAIR, SHOE_TOP_M, SHOES, hand_skin, template
from glsplat.skinning.smplx import JOINT_NAMES

DATA = resources.files("glsplat.extras.authoring.templates") / "data"


@pytest.mark.parametrize("name", HAIR)
def test_hair_is_on_the_head_and_bound_to_it(name: str) -> None:
    hair, body = template(name), open_body()
    head = body.vertices[body.part == JOINT_NAMES.index("head")]
    high = hair.vertices[hair.vertices[:, 1] > head[:, 1].mean()]
    assert abs(high[:, 0].mean()) < 0.03 and abs(high[:, 1].max() - head[:, 1].max()) < 0.12
    assert set(hair.joints[hair.weights > 0]) == {JOINT_NAMES.index("head")}
    assert len(hair.parts) == 1 and hair.parts[0].texture.shape == (512, 512, 4)


@pytest.mark.parametrize("name", SHOES)
def test_shoes_are_on_the_feet_and_each_bound_to_its_own(name: str) -> None:
    shoes, soles = template(name), open_body().vertices[:, 1].min()
    assert -0.04 < shoes.vertices[:, 1].min() - soles < 0.0
    assert SHOE_TOP_M - 0.15 < shoes.vertices[:, 1].max() < SHOE_TOP_M + 0.06
    side = {joint: JOINT_NAMES[joint].split("_")[0] for joint in np.unique(shoes.joints[shoes.weights > 0])}
    for name, sign in (("left", 1), ("right", -1)):
        mine = shoes.joints[sign * shoes.vertices[:, 0] > 0]
        assert {side[joint] for joint in np.unique(mine[shoes.weights[sign * shoes.vertices[:, 0] > 0] > 0])} == {name}


def test_licence_names_every_file_and_an_unknown_name_is_refused() -> None:
    text = (DATA / "LICENSE-templates.md").read_text()
    files = sorted(file.name for file in DATA.iterdir())
    assert [n for n in files if n.endswith(".npz")] == sorted(f"{name}.npz" for name in (*HAIR, *SHOES))
    assert not [name for name in (*HAIR, *SHOES, "hand_skin.jpg") if name not in text]
    assert "CC0" in text and hand_skin().shape == (512, 512, 3)
    with pytest.raises(FormatError, match="not 'fedora01'"):
        template("fedora01")
