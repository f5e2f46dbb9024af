"""The page's programs: the same chunks for another target, and nothing that a context without it would notice."""

from __future__ import annotations

import json

import pytest

from glsplat.errors import ShaderError
from glsplat.extras.browser.web_shaders import page_programs, page_variants
from glsplat.shaders import ResolveVariant, SkinVariant, Variant, flatten
from glsplat.shaders.slots import UNITS
from glsplat.shaders.variant import COLOUR_TEXELS, MAX_VIEWS, ROW_BITS, TARGETS


def put_together(table: dict, name: str, number: int) -> str:
    """As draw/programs.js does; the browser's own tests hold that against this."""
    program = table["programs"][name]
    defines = "".join(f"#define {flag}\n" for flag in program["defines"][number])
    return table["head"] + "\n" + defines + table["stages"][program["stages"][number]]


def test_the_table_is_json_and_gives_the_texts_of_the_loader() -> None:
    table = json.loads(json.dumps(page_programs()))
    rows = list(page_variants())
    assert table["units"] == UNITS
    assert len({name for name, *_ in rows}) == len(rows) == len(table["programs"])
    for name, stages, captured, variant in rows:
        assert table["programs"][name]["captured"] == list(captured)
        for number, stage in enumerate(stages):
            assert put_together(table, name, number) == flatten(f"{stage}.glsl", variant.defines()).text
    assert len(json.dumps(table)) < 100_000  # it is downloaded


def test_pages_draw_one_view_or_as_many_as_there_are() -> None:
    names = [name.split() for name, *_ in page_variants()]
    for program, place in (("project", 3), ("splat", 3)):
        assert {int(words[place]) for words in names if words[0] == program} == set(range(1, MAX_VIEWS + 1))


def test_what_es_has_not_is_not_in_its_texts() -> None:
    for _, stages, captured, variant in page_variants():
        assert variant.target == "es300" and not any("[" in name for name in captured)
        for stage in stages:
            text = flatten(f"{stage}.glsl", variant.defines()).text
            assert text.startswith("#version 300 es\nprecision highp float;")
            assert "#extension" not in text and "geometry" not in text.split("void main")[0].splitlines()[0]


def test_a_target_is_one_define_beside_the_rest() -> None:
    desktop, page = Variant(posed=1, views=2).defines(), Variant(posed=1, views=2, target="es300").defines()
    assert {name for name in desktop if desktop[name] != page[name]} == {"ES", "ROW_BITS"}
    assert (desktop["ES"], page["ES"]) == (0, 1)
    for shaders in (SkinVariant(), ResolveVariant()):
        assert shaders.defines()["ES"] == 0
    # the widest texture of SH degree 3 fits what SwiftShader has, and not as the desktop lays it out
    widest = [(1 << bits) * COLOUR_TEXELS[3] for bits in (ROW_BITS[target] for target in TARGETS)]
    assert widest == [12288, 6144]


def test_a_page_lacks_what_webgl_lacks() -> None:
    with pytest.raises(ShaderError, match="es300 has no geometry shaders"):
        Variant(geometry=1, target="es300")
    for kind in (Variant, SkinVariant, ResolveVariant):
        with pytest.raises(ShaderError, match="target is 330 or es300, not vulkan"):
            kind(target="vulkan")
