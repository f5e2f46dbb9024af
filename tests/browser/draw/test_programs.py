"""Every program that the page can ask for, compiled and linked by ANGLE: glslangValidator alone misses two rules."""

from __future__ import annotations

from glsplat.extras.browser.web_format.write import encode_avatar
from glsplat.extras.browser.web_shaders import page_variants
from glsplat.light.light import Light
from glsplat.shaders import flatten
from tests.browser.draw.conftest import Bench
from tests.extras.browser.web_format.test_web import someone, with_face
from tests.light.lit import surfaced

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


def test_every_program_links(bench: Bench) -> None:
    found = bench.js(LINK)
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
    assert "no program" in words[1] and "no program" in words[2]


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
