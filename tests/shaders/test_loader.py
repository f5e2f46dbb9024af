"""Flattening, flag checks, error positions, and every allowed variant compiled."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib import resources
from importlib.resources.abc import Traversable

import moderngl
import pytest

from glsplat.config import RenderConfig
from glsplat.errors import ShaderError
from glsplat.extras.browser.web_shaders import page_variants
from glsplat.extras.watermark.mark import Watermark
from glsplat.gl.context import Context
from glsplat.renderer.frame_block import frame_dtype
from glsplat.shaders import Programs, Variant, flatten, link, record_layout
from glsplat.shaders.slots import UNITS
from glsplat.shaders.variant import MeshVariant, ResolveVariant, SkinVariant, variant_for

FILES = [file for file in resources.files("glsplat.shaders").iterdir() if file.name.endswith(".glsl")]


def test_chunks_come_once_and_remember_their_lines() -> None:
    source = flatten("project.vert.glsl", Variant().defines())
    assert source.text.count("struct Footprint") == 1 and "#include" not in source.text
    assert len(source.origin) == source.text.count("\n")
    line = next(i for i, text in enumerate(source.text.splitlines()) if "float extent_of" in text)
    file, number = source.origin[line]
    text = (resources.files("glsplat.shaders") / file).read_text().splitlines()
    assert file == "extent.glsl" and "float extent_of" in text[number - 1]


REFUSED = {
    r"gl_PerVertex": "Intel's Windows driver rejects gl_Layer in a redeclared block",
    r"subgroup|ballot": "subgroups are missing on some drivers, and 4 to 64 wide on others",
    r"\bbool \w+\[": "zink of Mesa 22.3 compiles no array of bool",
    r"#\s*(?:version|extension)": "source.py adds versions, and extensions that may be missing",
}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_shaders_avoid_what_drivers_refuse(file: Traversable) -> None:
    text = re.sub(r"//.*", "", file.read_text())
    assert [reason for pattern, reason in REFUSED.items() if re.search(pattern, text)] == []


def test_a_misspelt_flag_is_refused() -> None:
    with pytest.raises(ShaderError, match=r"bad\.vert\.glsl:2: flag SH_DEGRE is not a field"):
        text = "void main() {\n#if SH_DEGRE > 0\n#endif\n}"
        flatten("bad.vert.glsl", Variant().defines(), overrides={"bad.vert.glsl": text})


def test_missing_chunk_and_circle() -> None:
    with pytest.raises(ShaderError, match="no shader chunk nothing"):
        flatten("a.glsl", {}, overrides={"a.glsl": '#include "nothing.glsl"'})
    with pytest.raises(ShaderError, match="includes itself"):
        flatten("a.glsl", {}, overrides={"a.glsl": '#include "b.glsl"', "b.glsl": '#include "a.glsl"'})


@pytest.mark.gl
def test_a_compile_error_names_chunk_and_line(gl: Context) -> None:
    chunk = "float broken() {\n    return missing_name;\n}"
    main = '#include "broken.glsl"\nvoid main() { gl_Position = vec4(broken()); }'
    source = flatten("main.vert.glsl", Variant().defines(), overrides={"main.vert.glsl": main, "broken.glsl": chunk})
    with pytest.raises(ShaderError, match=r"broken\.glsl:2: .*missing_name"):
        link(gl.ctx, "main", {"vertex_shader": source}, ("gl_Position",))


@pytest.mark.parametrize(
    "log", ["0:{n}(16): error: x", "0({n}) : error C0000: x", "ERROR: 0:{n}: x"], ids=["mesa", "nvidia", "apple"]
)
def test_log_dialects(log: str) -> None:
    source = flatten("a.glsl", {"FLAG": 1}, overrides={"a.glsl": "one\ntwo"})
    line = source.text.splitlines().index("two") + 1
    assert re.match(r"a\.glsl:2: .*x$", source.annotate(log.format(n=line)))


def test_every_flag_is_used_and_never_by_ifdef() -> None:
    code = "\n".join(re.sub(r"//.*", "", file.read_text()) for file in FILES)  # a comment is no use
    assert not re.search(r"#\s*ifn?def\b|\bdefined\b", code)
    for flag in Variant().defines() | SkinVariant().defines() | MeshVariant().defines() | ResolveVariant().defines():
        assert re.search(rf"\b{flag}\b", code), f"no shader reads {flag}"


def test_variants() -> None:
    config, mixed = RenderConfig(), frozenset({True, False})
    assert variant_for(1, config) == Variant()
    assert variant_for(2, config, stored_degree=3, posed=True) == Variant(
        sh_degree=3, stored_degree=3, posed=1, turned=1, views=2
    )
    assert variant_for(2, RenderConfig(sh_degree=1), stored_degree=3).sh_degree == 1
    assert variant_for(1, config, posed=True, antialias=mixed).antialias == 2
    assert variant_for(1, RenderConfig(antialias=False), posed=True, antialias=mixed).antialias == 0
    for wrong in (
        {"views": 3},
        {"sh_degree": 4},
        {"sh_degree": 1},  # more than is stored
        {"turned": 1},
        {"posed": 1, "sh_degree": 1, "stored_degree": 1},  # without turned
        {"antialias": 2},
        {"antialias": 3},
    ):
        with pytest.raises(ShaderError, match="variant"):
            Variant(**wrong)
    with pytest.raises(ShaderError, match="skin variant: influences is 1, 2, 4 or 8, not 3"):
        SkinVariant(influences=3)
    assert all(sum(floats for *_, floats in record_layout(v)) == v.record_floats for v in ROWS)


def attributes_of(program: moderngl.Program) -> set[str]:
    return {name for name in program if isinstance(program[name], moderngl.Attribute) and not name.startswith("gl_")}


def rows() -> list[Variant]:
    """Each flag alone and beside the flags that share its code; not all products, which double with every flag."""
    degrees = [{"sh_degree": d, "stored_degree": d} for d in range(4)] + [{"sh_degree": 1, "stored_degree": 3}]
    out = []
    for views in (1, 2):
        for degree in degrees:
            for posed in (0, 1):
                turned = int(bool(posed and degree["sh_degree"]))
                out.append(Variant(views=views, posed=posed, turned=turned, **degree))
                out.append(Variant(views=views, posed=posed, turned=turned, antialias=1 + posed, **degree))
        for antialias in (0, 1):
            for geometry, triangle in ((0, 1), (1, 0), (1, 1)):
                meshes = ({"occluded": 1}, {"sampled": 4}, {"occluded": 1, "sampled": 4}, {"depth": 1, "sampled": 4})
                for flags in ({}, {"depth": 1}, *meshes, {"depth": 1, "occluded": 1, "cut": 1}):
                    out.append(Variant(views=views, antialias=antialias, geometry=geometry, triangle=triangle, **flags))
        out.append(Variant(views=views, cull_hidden=1))
        out.append(Variant(views=views, cull_hidden=1, posed=1, cut=1))
        out.append(Variant(views=views, cut=1))
        out.append(Variant(views=views, numbered=1, cull_hidden=1))
        out.append(Variant(views=views, lit=1))
        for degree in degrees[1:]:
            out.append(Variant(views=views, posed=1, turned=int(degree["sh_degree"] > 0), lit=1, **degree))
        for degree in degrees[:2]:
            for flags in ({"triangle": 1}, {}, {"triangle": 1, "antialias": 1}, {"triangle": 1, "depth": 1}):
                out.append(Variant(views=views, pulled=1, **degree, **flags))
        out.append(Variant(views=views, pulled=1, triangle=1, geometry=1, occluded=1, cut=1))
    return out


ROWS = rows()
SKINS = [SkinVariant(influences=k, raw=raw, turned=turned) for k in (1, 2, 4, 8) for raw in (0, 1) for turned in (0, 1)]
SKINS += [replace(skin, shaped=1) for skin in SKINS]
RESOLVES = [ResolveVariant(cull_hidden=hidden) for hidden in (0, 1)]
MESHES = [MeshVariant(), MeshVariant(logarithmic=1), MeshVariant(shaded=1)]
PAGES = [variant for *_, variant in page_variants()]
OTHERS = [*SKINS, *MESHES, *RESOLVES]


@pytest.mark.gl
def test_the_variants_that_matter_compile(gl: Context) -> None:
    programs = Programs(gl.ctx)
    for variant in ROWS:
        if variant.pulled and not gl.vertex_storage:
            continue
        programs.feedback("key", variant, ("key", "cover"))
        programs.feedback("project", variant, [name for name, _ in record_layout(variant)])
        program = programs.draw("splat", "splat", variant)
        assert attributes_of(program) == {name for name, _ in record_layout(variant) if not variant.pulled}
        block = programs.draw("screen", "background", variant)["Frame"]
        assert isinstance(block, moderngl.UniformBlock) and block.size == frame_dtype(variant.views).itemsize
    posed = ("posed_mean", "posed_x", "posed_y", "posed_z")
    for numbered in (0, 1):
        programs.feedback("place", Variant(numbered=numbered), posed)
    for skin in SKINS:
        programs.feedback("skin", skin, posed)
    for mesh in MESHES:
        programs.draw("mesh", "mesh", mesh)
    for resolve in RESOLVES:
        for step in ({}, {"step.glsl": Watermark(1, 2, b"sixteen bytes 01").source}):
            program = programs.draw("screen", "resolve", resolve, step)
            assert ("step_texture" in program, "background" in program) == (bool(step), bool(resolve.cull_hidden))
    programs.release()


def test_slots() -> None:
    """Every sampler of every shader has a unit, and no program has two on one."""
    for file in FILES:
        if file.name.count(".") < 2:
            continue
        flags = dict.fromkeys(
            Variant().defines() | SkinVariant().defines() | MeshVariant().defines() | ResolveVariant().defines(), 1
        )
        shown = {"ANAGLYPH": 0, "TEXT": 1, "LIFTED": 1, "LINEAR": 1, "DEPTH": 1, "ROOM": 1}
        text = flatten(file.name, flags | shown).text
        samplers = re.findall(r"^uniform sampler\w+ (\w+);", text, re.MULTILINE)
        units = [UNITS[name] for name in samplers]
        assert len(set(units)) == len(units), f"{file.name}: {samplers}"
