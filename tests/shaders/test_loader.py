"""Flattening, flag checks, error positions, and every allowed variant compiled."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import resources

import moderngl
import pytest

from glsplat.config import RenderConfig
from glsplat.context import Context
from glsplat.errors import ShaderError
from glsplat.passes.frame import frame_dtype
from glsplat.passes.project import record_layout
from glsplat.shaders import Programs, Variant, flatten, link
from glsplat.shaders.variant import every_variant, variant_for

FILES = [file for file in resources.files("glsplat.shaders").iterdir() if file.name.endswith(".glsl")]


def attributes_of(program: moderngl.Program) -> set[str]:
    return {name for name in program if isinstance(program[name], moderngl.Attribute) and not name.startswith("gl_")}


@pytest.fixture
def gl(context: Context) -> Iterator[Context]:
    with context.ctx:
        yield context


def test_chunks_come_once_and_remember_their_lines() -> None:
    source = flatten("project.vert.glsl", Variant().defines())
    assert source.text.count("struct Footprint") == 1 and "#include" not in source.text
    assert len(source.origin) == source.text.count("\n")
    line = next(i for i, text in enumerate(source.text.splitlines()) if "float extent_of" in text)
    file, number = source.origin[line]
    text = (resources.files("glsplat.shaders") / file).read_text().splitlines()
    assert file == "extent.glsl" and "float extent_of" in text[number - 1]


def test_a_misspelt_flag_is_refused() -> None:
    with pytest.raises(ShaderError, match=r"bad\.vert\.glsl:2: flag SH_DEGRE is not a field"):
        flatten(
            "bad.vert.glsl",
            Variant().defines(),
            overrides={"bad.vert.glsl": "void main() {\n#if SH_DEGRE > 0\n#endif\n}"},
        )


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
    text = "\n".join(file.read_text() for file in FILES)
    assert not re.search(r"#\s*ifn?def\b|\bdefined\b", text)
    for flag in Variant().defines():
        assert re.search(rf"\b{flag}\b", text), f"no shader reads {flag}"


def test_variants() -> None:
    config = RenderConfig()
    assert variant_for(0, 0, 1, config) == Variant()
    assert variant_for(3, 4, 2, config) == Variant(sh_degree=3, influences=4, views=2, keep_rotation=1)
    assert variant_for(3, 8, 2, RenderConfig(sh_degree=1, influences=2)).influences == 2
    for wrong in ({"raw": 1}, {"views": 3}, {"sh_degree": 4}, {"influences": 3}, {"keep_rotation": 1}):
        with pytest.raises(ShaderError, match="variant"):
            Variant(**wrong)
    assert all(sum(floats for *_, floats in record_layout(v)) == v.record_floats for v in every_variant())


@pytest.mark.gl
def test_every_variant_compiles(gl: Context) -> None:
    programs = Programs(gl.ctx)
    for variant in every_variant():
        if variant.influences:
            programs.feedback("skin", variant, ("posed_mean", "posed_x", "posed_y", "posed_z"))
        programs.feedback("key", variant, ("key", "cover"), separate=True)
        programs.feedback("project", variant, ("rgb", "alpha", "centre", "cholesky"))
        program = programs.draw("splat", "splat", variant)
        assert attributes_of(program) == {name for _, name, _ in record_layout(variant)}
        block = programs.draw("screen", "background", variant)["Frame"]
        assert isinstance(block, moderngl.UniformBlock) and block.size == frame_dtype(variant.views).itemsize
    programs.release()


@pytest.mark.gl
def test_what_a_scene_does_not_need_is_left_out(gl: Context) -> None:
    programs = Programs(gl.ctx)
    static = programs.feedback("project", Variant(), ("rgb", "alpha", "centre", "cholesky"))
    assert attributes_of(static) == {"mean_opacity", "quat", "scale", "sh0"}
    assert "bones" not in static
    posed = programs.feedback("project", Variant(influences=4), ("rgb", "alpha", "centre", "cholesky"))
    assert attributes_of(posed) == {"mean_opacity", "shape_x", "shape_y", "shape_z", "sh0"}
    assert "extension" not in flatten("splat.vert.glsl", Variant().defines()).text
    assert "extension" in flatten("splat.vert.glsl", Variant(views=2).defines()).text
    programs.release()
