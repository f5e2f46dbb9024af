"""Work and precision: ways, their times and errors, the options to paste, and the page of them."""

from __future__ import annotations

import json
from argparse import ArgumentParser
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from apps import render as render_command
from apps.args import detail_of
from apps.serve.options import ServeOptions, read_options
from glsplat.config import LEAN, RenderConfig
from glsplat.extras.evaluate import precision
from glsplat.extras.evaluate.precision import SERVED, Way, advice, measure, render_words, serve_lines
from glsplat.extras.evaluate.subjects import Subject
from glsplat.gl.context import Context
from glsplat.splats import Level
from tests.scenes import camera, cloud, limb
from tools.docs import precision as page

pytest.importorskip("flip_evaluator")

BASE = Way()


def test_words_name_what_differs() -> None:
    assert BASE.words == "default" and BASE.method == "all splats"
    way = Way(level=2, hidden=True, sigma=2.5, scale=0.75, jpeg=(90, "420"))
    assert way.words == "level 2, 0.75 x, no hidden splats, 2.5 sigma, q90 420"
    assert way.drawn.method == "no hidden splats, 2.5 sigma"


def test_times_are_ratios_to_the_default_of_the_same_turn() -> None:
    """A turn that something else holds up counts for both; a period's turns are summed."""
    base = [(10.0, 1.0)] * 8 + [(90.0, 1.0)] * 8
    low, ratio, high = precision._ratios([(wall * 1.5, 1.0) for wall, _ in base], base)
    assert low == ratio == high == pytest.approx(1.5)
    sorts = [(14.0, 1.0), (6.0, 1.0)] * 8  # sorts in every second turn
    assert precision._ratios(sorts, [(10.0, 1.0)] * 16, 2)[1] == pytest.approx(1.0)
    values = [(float(v), 1.0) for v in range(1, 101)]
    assert precision._ratios(values, [(1.0, 1.0)] * 100) == (41.0, 50.5, 60.0)  # ranks 41 and 60 of 100


def test_candidates_near_the_front() -> None:
    ways = [Way(level=n) for n in range(4)]
    ms = dict(zip(ways, (10.0, 5.0, 5.2, 8.0), strict=True))
    psnr = dict(zip(ways, (50.0, 40.0, 40.0, 39.0), strict=True))
    assert precision._near(ms, psnr.__getitem__) == [ways[1], ways[0]]
    assert precision._near(ms, psnr.__getitem__, 1.05) == [ways[1], ways[2], ways[0]]


@pytest.mark.parametrize("way", [BASE, Way(level=3), Way(hidden=True, target="16f"), Way(degree=1)])
def test_options_of_render_parse_to_the_way(way: Way) -> None:
    parser = ArgumentParser()
    render_command.add_arguments(parser)
    words = render_words(way, BASE)
    assert words is not None
    args = parser.parse_args([*words, "-o", "x.png"])
    target = "32f" if args.float_target == "auto" else args.float_target
    config = RenderConfig(**{"target": target, "sh_degree": args.sh_degree, **detail_of(args)})
    assert config == way.config(RenderConfig())


@pytest.mark.parametrize(("way", "auto"), [
    (Way(jpeg=SERVED), True),
    (Way(2, True, LEAN.max_sigma, "8", jpeg=(90, "420"), scale=0.5), True),
    (Way(1, True, LEAN.max_sigma, "8", jpeg=SERVED), False),
    (Way(1, False, LEAN.max_sigma, "8", jpeg=SERVED), False),
])  # fmt: skip
def test_lines_of_serve_parse_to_the_way(way: Way, auto: bool, tmp_path: Path) -> None:
    lines = serve_lines(way, BASE, auto, (512, 512))
    assert lines is not None
    file = tmp_path / "server.toml"
    file.write_text("\n".join(lines))
    args = ServeOptions(**read_options(file))
    config = RenderConfig(**{"target": "32f", **detail_of(args)})
    if config.target == "fast":
        config = replace(config, target="8")
    if config.cull_hidden == "auto":
        config = replace(config, cull_hidden=auto)
    assert config == way.config(RenderConfig()) and way.jpeg == (args.quality, "420")
    assert args.size == (512 * way.scale, 512 * way.scale)


def test_ways_without_options_have_none() -> None:
    for way in (Way(sigma=2.5), Way(bits=16), Way(period=2), Way(scale=0.5), Way(jpeg=SERVED)):
        assert render_words(way, BASE) is None
    for way in (BASE, Way(jpeg=(80, "444")), Way(target="8", jpeg=SERVED), Way(level=1, jpeg=SERVED)):
        assert serve_lines(way, BASE, True, (64, 64)) is None
    assert serve_lines(Way(sigma=2.5, target="8", jpeg=SERVED), BASE, True, (64, 64)) is None  # serve would cull


def row(way: Way, ms: float, psnr: float, lpips: float | None, **more: Any) -> dict[str, Any]:
    values = {"words": way.words, "method": way.method, "way": asdict(way), "ms": ms, "low": ms - 1, "high": ms + 1}
    values |= {"cpu_ms": 2 * ms, "psnr": psnr, "maximum": 0.1, "flip": 0.01, "lpips": lpips, "front": True}
    lines = serve_lines(way, BASE, False, (64, 64))
    return values | {"marks": [], "render": render_words(way, BASE), "serve": lines, **more}


def test_the_cheapest_that_cannot_be_seen_is_advised() -> None:
    rows = [
        row(BASE, 40, 110, 0.0, marks=["render"]), row(Way(level=1), 20, 45, 0.004),
        row(Way(level=2), 10, 41, 0.02), row(Way(level=1, sigma=2.5), 5, 50, 0.0),
    ]  # fmt: skip
    words, chosen = advice({"rows": rows})["render"]
    assert words == ["--level", "1"] and not chosen["visible"]
    unseen = [one | {"lpips": None} for one in rows]  # no weights: by PSNR
    assert advice({"rows": unseen})["render"][0] == ["--level", "2"]
    words, chosen = advice({"rows": rows[2:3]})["render"]
    assert words == ["--level", "2"] and chosen["visible"]


@pytest.mark.gl
def test_a_scene_with_levels_and_cones(context: Context) -> None:
    """Default and copy are paired, coarser is worse, marks and options are there, and all of it is JSON."""
    cones = np.tile(np.array([0, 0, 127, 0], np.int8), (300, 1))
    scene = replace(cloud(300), cones=cones, cones_psnr=50.0, levels=(Level(cloud(60, seed=5), 5.0),))
    result = measure(context, Subject("cloud", scene, 48), 3)
    assert json.loads(json.dumps(result))["scene"] == "cloud"
    rows = {row["words"]: row for row in result["rows"]}
    assert rows["default"]["psnr"] > 65 and rows["default"]["marks"] == ["render"] and rows["default"]["render"] == []
    assert any("serve" in row["marks"] and row["way"]["jpeg"] for row in result["rows"])
    assert all(row["low"] <= row["ms"] <= row["high"] and row["cpu_ms"] > 0 for row in result["rows"])
    assert any(row["front"] for row in rows.values()) and rows["default"]["flip"] is not None
    assert {"render", "serve"} == set(advice(result))
    seeds = [Way(**one) for one in result["candidates"]]
    again = measure(context, Subject("cloud", scene, 64), 3, seeds=seeds[:2])
    assert not again["searched"] and again["size"] == [64, 64]


@pytest.mark.gl
def test_old_orders_are_compared_at_their_oldest(context: Context) -> None:
    study = precision._Study(context, Subject("limb", limb(300, degree=1), 48, moving=True), None, lambda _: None)
    psnr = []
    for period in (1, 2, 4):
        study._compare(way := replace(study.default, period=period))
        psnr.append(study._psnr(way))
    assert psnr[0] > 65 and psnr[0] > psnr[1] > psnr[2]
    given = precision._Study(context, Subject("given", cloud(10), 32, cameras=(camera(32),)), None, lambda _: None)
    assert {way.period for way in given._neighbours(given.default)} == {1}


def test_the_page(tmp_path: Path) -> None:
    """One size with LPIPS, one without its weights."""
    pytest.importorskip("matplotlib")
    served = Way(level=1, sigma=2.5, target="8", jpeg=SERVED)
    many = [row(Way(level=n), 40 - n, 60 - n, 0.001 * n) for n in range(1, 16)]
    rows = [row(BASE, 41, 110, 0.0, marks=["render"]), row(served, 9, 33, 0.009, marks=["serve"]), *many]
    rows.append(row(Way(scale=0.5), 39, 57, 0.02, marks=["--fps"], front=False))
    result = {"scene": "a cloud", "splats": 1000, "views": 2, "size": [512, 512], "frames": 24, "rows": rows}
    result |= {"quiet": {"others": 0.01, "noise": 0.002}, "searched": [{"ms": 3.0, "psnr": 30.0}]}
    blind = result | {"rows": [one | {"lpips": None} for one in rows], "size": [64, 64]}
    (_, _, without), (name, about, text) = page.page({"cloud": [blind, result]}, tmp_path)
    assert "Use `glsplat render --level 15`" in without and "![" not in without
    assert name == "cloud-512" and "other processes used 1.0% of the cores" in about
    lines = [line for line in text.splitlines() if line.startswith("| ")][1:]
    assert len(lines) == page.MOST_ROWS and lines[0].startswith(
        "| level 1, 2.5 sigma, target 8, q80 420 | 9.0 | 8.0 - 10.0 | 18.0 |"
    )
    assert lines[-1].endswith("default of `render`, front |") and "| level 15 | 25.0" in text
    assert "Use `glsplat render --level 10`" in text and "`level = 1`" in text
    assert "Off the front: `0.5 x` of `--fps`; `level 3` is 5% faster and 0.0 dB closer." in text
    assert text.count("Off the front") == 1
    assert "](../images/precision-cloud.png)" in text and (tmp_path / "precision-cloud.png").stat().st_size > 1000
