"""Every program that the page can ask for, compiled and linked by ANGLE: glslangValidator alone misses two rules."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from glsplat.shaders import flatten
from glsplat.shaders.web import page_variants
from tests.browser.draw.conftest import Bench

LINK = """async () => {
  const { Programs, textOf } = await import('/vr/draw/programs.js');
  const { context } = await import('/vr/test/page.js');
  const table = await (await fetch('/vr/draw/programs.json')).json();
  const gl = context();
  const programs = new Programs(gl, table);
  const linked = Object.keys(table.programs).filter((name) => programs.get(name).program);
  const stages = (name) => table.programs[name].stages.map((_, i) => textOf(table, name, i));
  const texts = Object.fromEntries(linked.map((name) => [name, stages(name)]));
  const attributes = programs.get('project 3 1 2 1').attributes;
  programs.release();
  return { linked, texts, attributes: Object.keys(attributes), error: gl.getError() };
}"""


@pytest.mark.parametrize("driver", ["mesa", "chromium"])
def test_every_program_links(driver: str, request: pytest.FixtureRequest, bench_of: Callable[[Any], Bench]) -> None:
    found = bench_of(request.getfixturevalue(driver)).js(LINK)
    rows = {name: (stages, variant) for name, stages, _, variant in page_variants()}
    assert found["error"] == 0 and set(found["linked"]) == set(rows)
    for name, (stages, variant) in rows.items():
        assert found["texts"][name] == [flatten(f"{stage}.glsl", variant.defines()).text for stage in stages]
    assert set(found["attributes"]) - {"gl_VertexID"} == {"order"}


def test_a_program_that_does_not_compile_says_where(bench: Bench) -> None:
    words = bench.js("""async () => {
      const { Programs } = await import('/vr/draw/programs.js');
      const { context } = await import('/vr/test/page.js');
      const table = structuredClone(await (await fetch('/vr/draw/programs.json')).json());
      table.stages['skin.vert'] = table.stages['skin.vert'].replace('uniform float size', 'uniform float sise');
      const said = [];
      const programs = new Programs(context(), table);
      for (const name of ['skin 4 0 0', 'skin 3 0 0', 'toString']) {
        try { programs.get(name); } catch (error) { said.push(error.message); }
      }
      return said;
    }""")
    assert "skin 4 0 0" in words[0] and "'size' : undeclared identifier" in words[0]
    assert words[1:] == [
        json.loads(f'"there is no program \\"{n}\\" for this page"') for n in ("skin 3 0 0", "toString")
    ]
