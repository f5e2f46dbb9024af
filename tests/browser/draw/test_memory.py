"""Avatars come and go, frames pass: nothing stays behind."""

from __future__ import annotations

from glsplat.formats.web.write import encode_avatar
from glsplat.light.light import Light
from tests.browser.draw.conftest import Bench
from tests.formats.web.test_web import someone, with_face
from tests.light.lit import surfaced


def test_many_avatars_in_turn_leave_nothing(bench: Bench) -> None:
    """Of four kinds, so that variants and sizes change, too; by hand 100 with 100 frames each: 10,000."""
    kinds = [someone(300, 0, 4, 20), someone(700, 3, 1, 5), with_face(someone(450, 1, 2, 12)), someone(1100, 0, 8, 30)]
    kinds[1:3] = map(surfaced, kinds[1:3])  # lit in every second frame
    names = []
    for number, avatar in enumerate(kinds):
        names.append(f"kind{number}")
        bench.data[names[-1]] = encode_avatar(avatar)
    question = {"names": names, "turns": 40, "frames": 4, "light": Light.preset("left").to_json()}
    found = bench.js("(question) => import('/vr/test/page.js').then((m) => m.inTurn(question))", question)
    early, late, released = found
    assert early["error"] == late["error"] == 0
    assert early["cache"] <= 9 and late["cache"] <= 9
    for kind, count in late["alive"].items():
        assert count <= early["alive"][kind] + 4, (kind, early, late)  # by which avatar it is of the four
    assert late["heap"] < early["heap"] + 3
    assert set(released["alive"].values()) == {0}, released
