"""What splats know of their surface in the file that browsers fetch: byte for byte, nothing where there is none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.formats.web.read import decode_avatar, read_header
from glsplat.formats.web.write import encode_avatar
from glsplat.splats import Level
from tests.formats.test_contract import peak_of
from tests.formats.web.test_web import LIES, Change, changed, of_part, someone, with_face
from tests.light.lit import surfaced


@pytest.mark.parametrize("shaded", [True, False])
def test_it_comes_back_to_the_byte_with_its_levels(shaded: bool) -> None:
    first = surfaced(with_face(someone(500, seed=12)), seed=3, shaded=shaded)
    coarse = surfaced(replace(someone(90, seed=8), skeleton=first.skeleton), seed=4, shaded=not shaded)
    last = replace(someone(40, seed=2), skeleton=first.skeleton)
    data = encode_avatar(replace(first, levels=(Level(coarse, 120.0, 31.5), Level(last, 60.0, 28.0))))
    back = decode_avatar(data)
    kinds = [(part.kind, part.level) for part in read_header(data)[0].parts]
    assert kinds[-2:] == [("surface", 0), ("surface", 1)]  # behind all that a picture needs
    for one, was in ((back, first), (back.levels[0].content, coarse)):
        at = [int(np.abs(was.splats.means - mean).sum(axis=1).argmin()) for mean in one.splats.means]
        found, expected = one.splats.surface, was.splats.surface
        wanted = expected.take(at)
        assert np.array_equal(found.normals, wanted.normals) and np.array_equal(found.occlusion, wanted.occlusion)
        assert (found.shade is None) == (wanted.shade is None)
        assert np.array_equal(found.shades_or_one(), wanted.shades_or_one())
    assert back.levels[1].content.splats.surface is None


FALSE: list[dict[str, Any]] = [{"shaded": False}, {"shaded": 1}, {"level": 1}, {"kind": "light"}, {"bytes": 5}]
FALSE_LIES = [of_part(2, **lie) for lie in FALSE]


@pytest.mark.parametrize(
    "lie", [*FALSE_LIES, LIES["more splats"], lambda header: header["parts"].append(header["parts"][2])]
)
def test_lies_about_it_are_refused(lie: Change) -> None:
    data = changed(encode_avatar(surfaced(with_face(someone(300)))), lie)

    def read() -> None:
        with pytest.raises(FormatError) as caught:
            decode_avatar(data)
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 300

    assert peak_of(read) < 4_000_000
