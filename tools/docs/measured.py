"""Write the pages of docs/measured: tables that commands print, with commit, driver and date, and their copies.

    python -m tools.docs.measured               # all pages, forty minutes; nothing else may run on the machine
    python -m tools.docs.measured frame         # one of them
    python -m tools.docs.measured --copies      # only update the copies

Another page shows a copy of a table between ``<!-- measured: PAGE/TABLE -->`` and ``<!-- end -->``; `make docs` updates
copies.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

from apps.demo import running_server
from apps.replay.latency import PAPER
from apps.replay.streaming import STAGES
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.frames import Quiet, until_quiet
from glsplat.extras.evaluate.stability.extremes import all_cases
from glsplat.extras.evaluate.stability.frame import judge
from glsplat.gl.context import create_context
from glsplat.io.files import replace_file
from glsplat.io.provenance import machine
from tests.conftest import SHARED_DATA
from tools.docs import precision
from tools.docs.approximations import ABOUT, others_plot
from tools.net import ladder_table
from tools.net.link_tables import alone, busy, datagrams, falling, shared, video

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "measured"
SIZES = (512, 768, 1024)
LINKS = ("20,50", "40,50", "40,5")  # round trip in ms, Mbit/s

_TABLE = re.compile(r"<!-- table: (\S+) -->\n\n(.*?)\n\n<!-- end -->", re.S)
_COPY = re.compile(r"(<!-- measured: (\S+)/(\S+) -->\n\n).*?(\n\n<!-- end -->)", re.S)

Table = tuple[str, str, str]  # name, describing paragraph, markdown


def tables(page: str) -> dict[str, str]:
    """Return the tables of a page of docs/measured as Markdown, by name."""
    return {name: text for name, text in _TABLE.findall((FOLDER / f"{page}.md").read_text(encoding="utf-8"))}


def with_copies(text: str) -> str:
    """Return a page's text with its copies of measured tables updated. Raises KeyError for an unknown table."""
    return _COPY.sub(lambda copy: copy[1] + tables(copy[2])[copy[3]] + copy[4], text)


def pages_with_copies() -> Iterator[Path]:
    """Yield README and the pages of docs that show a measured table."""
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        if _COPY.search(path.read_text(encoding="utf-8")):
            yield path


def command(*words: str, cwd: Path = ROOT) -> str:
    """Return the output of ``glsplat WORDS``."""
    return script("apps.cli", *words, cwd=cwd)


def script(module: str, *words: str, cwd: Path = ROOT) -> str:
    """Return the output of ``python -m MODULE WORDS``."""
    print("python -m", module, *words, file=sys.stderr, flush=True)
    here = {**os.environ, "PYTHONPATH": str(ROOT)}
    line = (sys.executable, "-m", module, *words)
    done = subprocess.run(line, cwd=cwd, env=here, stdout=subprocess.PIPE, check=True)
    return done.stdout.decode()


def table_of(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table, with the first column aligned left and the others right."""
    lines = [heads, ["---", *["--:"] * (len(heads) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def frame() -> Iterator[Table]:
    """Measure a frame stage by stage."""
    sizes = [f"{side}x{side}" for side in SIZES]
    exact = command("bench", "--sizes", *sizes, "--frames", "16")
    yield (
        "exact",
        "`glsplat bench`, the embedded avatar, every splat of the finest level. Draw floor: the same records, already\n"
        "projected and sorted, drawn alone. Stages are of a second renderer that waits after each.",
        f"```\n{exact.strip()}\n```",
    )
    lean = command("bench", "--sizes", *sizes, "--frames", "16", "--level", "auto", "--cull-hidden")
    yield "levels", "The same with levels of detail, without hidden splats.", f"```\n{lean.strip()}\n```"


def hard() -> Iterator[Table]:
    """Run every stability case."""
    context = create_context()
    rows = ["| of | case | input | stated behaviour | largest error | |", "|---|---|---|---|--:|---|"]
    for row in judge(all_cases(), context):
        error = "" if row["error"] is None else f"{row['error']:.2g} {row['unit']}"
        rows.append("| " + " | ".join([*hard_cells(row), error, row["verdict"]]) + " |")
    context.release()
    yield "cases", "`glsplat report`, section 3. Errors are against float64, or what the unit says.", "\n".join(rows)


def hard_cells(row: dict[str, Any]) -> list[str]:
    """Return the cells of a stability case that do not depend on the driver."""
    return [row[key].replace("|", "/") for key in ("group", "case", "input", "behaviour")]


def poses() -> Iterator[Table]:
    """Measure the cost of answers as poses."""
    text = script("tools.net.poses", "--people", "1", "10", "--rate", "20", "72")
    note = "`python -m tools.net.poses`: everybody of a room sends and draws everybody, the embedded recording."
    yield "room", note, _markdown(text)


def tracking() -> Iterator[Table]:
    """Score tracking and body sizes on captured motions of the reference data beside the checkout."""
    clips = [f"cmu_02_0{clip}.amc" for clip in (1, 3, 4, 5)] + [f"cmu_131_0{clip}.bvh" for clip in (1, 2, 3)]
    words = ("tracking", "bench", *clips, "--groups", "cmu_([0-9]+)_")
    scores = command(*words, "--brief", "--rates", "72", cwd=SHARED_DATA / "mocap")
    yield (
        "scores",
        "`glsplat tracking bench`, 72 Hz, the embedded avatar: the network has learned from 02 (walks, runs, jumps,"
        " boxes),\nnot from 131 (dances). Columns: [tracking.md](../tracking.md#accuracy).",
        scores.strip(),
    )
    means = command(*words, "--brief", "--rates", "30,90", cwd=SHARED_DATA / "mocap")
    rows = [row for row in _markdown(means).splitlines() if row.startswith(("| clip", "| ---", "| **all**"))]
    yield "rates", "The same at 30 and 90 Hz, means of all.", "\n".join(rows)
    from tools.data import sizes

    yield (
        "sizes",
        "`python -m tools.data.sizes`: people of the CMU pack, statures times 0.8 to 1.1, whose size is found as they"
        " go.",
        sizes.table(sizes.found(sizes.persons((SHARED_DATA / "mocap_cmu").glob("*.npz")))),
    )


def stream() -> Iterator[Table]:
    """Measure pictures over the wire, with server and client on this machine."""
    sizes = [str(side) for side in SIZES]
    common = ("demo", "-o", str(ROOT / "out" / "measured"), "--seconds", "6", "--sizes", *sizes, "--json")
    exact = json.loads(command(*common, "--exact"))["runs"]
    lean = json.loads(command(*common))["runs"]
    rows = []
    for name, runs in (("every splat (`--exact`)", exact), ("as `serve` draws it", lean)):
        cells = [f"{run['fps']:.0f} a second, {run['age_ms']['median']:.0f} ms old" for run in runs.values()]
        rows.append([name, *cells])
    heads = ["from raw tracking to decoded JPEG, both eyes", *(f"2 x {side}^2" for side in SIZES)]
    about = "`glsplat demo`: pictures shown a second, and the median age of the one on show."
    yield "summary", about, table_of(heads, rows)
    ours = [lean[f"{side}x{side}"]["stages_ms"] for side in (512, 1024)]
    rows = []
    for key, name, _ in STAGES:
        cells = [f"{run[key][part]:.1f}" for run in ours for part in ("median", "p95")]
        rows.append([name, str(PAPER[key]), *cells])
    yield (
        "paper",
        "Medians in ms beside the paper's appendix (localhost, 2 x 1024^2, a CUDA rasterizer on a desktop GPU).\n"
        "Its decoding includes the display. Both columns of glsplat are drawn by a CPU.",
        table_of(["stage", "paper", "glsplat, 2 x 512^2", "p95", "glsplat, 2 x 1024^2", "p95"], rows),
    )
    with running_server(None) as url:
        for side in (512, 1024):
            text = command("replay", "--url", url, "--size", str(side), "--frames", "432", "--compare")
            yield f"policies-{side}", f"`glsplat replay --compare`, loopback, 2 x {side}^2.", _markdown(text)
        links = [word for link in LINKS for word in ("--link", link)]
        text = command("replay", "--url", url, "--size", "512", "--frames", "288", "--compare", *links)
        note = "Over simulated links (a relay in user space; no loss, no jitter), 2 x 512^2."
        yield "links", note, _markdown(text)


def links() -> Iterator[Table]:
    """Simulate streams over links."""
    about = (
        "**Simulated**: the server's control of a link in front of a model of renderer, TCP and client\n"
        "(tools/net/simulated_link.py says what is modelled, and that TCP's own window is not). 2 x 1024^2, 20 pairs\n"
        "a second at full size. Twice the columns: the server, and who knows rate and round trip\n"
        "(oracle). `used`: of the rate; where all that can be seen passes (LPIPS .008),\n"
        "there is nothing more to spend it on. LPIPS by the table of [ladder.md](ladder.md)."
    )
    yield "alone", about, "\n".join(alone())
    note = "20 Mbit/s, 3 from second 20 to 40, 20 again. Fixed: always two under way. Simulated as above, no loss."
    yield "falling", note, "\n".join(falling())
    yield "shared", "Two clients of one link. Simulated as above, no loss.", "\n".join(shared())
    note = (
        "A client that looks at what arrived only so often, at 100 Mbit/s and 1 ms. Simulated as above, no loss.\n"
        "Once a server that hears of arrivals from the client alone, once with pings behind pictures."
    )
    yield "busy", note, "\n".join(busy())
    note = (
        "Pictures of a tenth of the bytes, as video has them (6.4 kB a pair, [codec.md](codec.md)), beside JPEG.\n"
        "Simulated as above; neither key frames nor how much less quality saves in a video is modelled."
    )
    yield "video", note, "\n".join(video())
    note = (
        "Pictures by datagrams (`webtransport`) beside TCP. Simulated as above; headers and parity count\n"
        "for datagrams, headers of TCP do not. Requests and answers are not lost in either."
    )
    yield "datagrams", note, "\n".join(datagrams())


def ladder() -> Iterator[Table]:
    """Measure bytes and visible loss of JPEG sizes and qualities."""
    files = os.environ.get("GLSPLAT_MEASURED_AVATARS", "").split()
    about = (
        "The left eye of `glsplat replay` at 1024^2, the embedded people, and an avatar of 39,998\n"
        "splats of another person (files named by GLSPLAT_MEASURED_AVATARS). JPEG as the server makes it, decoded,\n"
        "enlarged to full size; LPIPS (AlexNet) and PSNR in the avatar's box against the uncompressed picture of full\n"
        "size. Shown are those on the front of 4:2:0: none else has fewer bytes in the box and less LPIPS.\n"
        "glsplat/net/pace/ladder.py is drawn from it."
    )
    yield "moments", about, ladder_table.table(files, ladder_table.DEVELOPED)
    note = "The same for moments of other motions, which the ladder was not drawn from."
    yield "set-aside", note, ladder_table.table(files, ladder_table.SET_ASIDE)


def _markdown(text: str) -> str:
    """Return the table in a command's output. Raises ValueError without one."""
    rows = [line for line in text.splitlines() if line.startswith("|")]
    if len(rows) < 3:
        raise ValueError(f"no table in what the command printed: {text[:200]!r}")
    return "\n".join(rows)


PAGES: dict[str, tuple[str, Callable[[], Iterator[Table]]]] = {
    "hard": ("Hard cases", hard),
    "poses": ("Poses over the wire", poses),
    "tracking": ("Tracking", tracking),
    "frame": ("A frame", frame),
    "stream": ("The stream", stream),
    "links": ("Far links", links),
    "ladder": ("Sizes and qualities", ladder),
}


UNTIMED = ("hard", "links", "ladder")
"""Pages without times, which need no quiet machine."""


def written(page: str) -> bytes:
    """Measure a page of docs/measured, twice if the machine was not quiet. Raises GlsplatError."""
    title, measure = PAGES[page]
    how = f"python -m tools.docs.measured {page}"
    if page in UNTIMED:
        return page_of(title, how, _said(None), measure())
    found, quiet = until_quiet(lambda _: (list(measure()), _noise()), 1, lambda text: None)
    precision.check_quiet(f"{page}.md", quiet)
    return page_of(title, how, _said(quiet), found)


def written_precision(person: Path, minutes: float) -> bytes:
    """Measure the page of work and precision, which has a gate for each scene. Raises GlsplatError."""
    found = precision.measured(ROOT / "out" / "measured" / "precision", person, minutes)
    how = "python -m tools.docs.measured precision --person PERSON.glb"
    said = f"{_said(None)} {precision.about_errors()}"
    images = ROOT / "docs" / "images"
    replace_file(images / "precision-others.png", [others_plot(FOLDER)])
    others = ("others", ABOUT, "![Solver, JPEGs, splats of a fit, late pictures](../images/precision-others.png)")
    return page_of("Work and precision", how, said, [*precision.page(found, images), others])


def _noise() -> float:
    """Return the relative difference of two halves of a series of bench."""
    row = json.loads(command("bench", "--static", "--sizes", "256x256", "--frames", "60", "--json"))["settings"][0]
    return float(row["noise"])


def _said(quiet: Quiet | None) -> str:
    facts = machine()
    driver = json.loads(command("bench", "--static", "--sizes", "64x64", "--frames", "3", "--json"))["driver"]
    return (
        f"Commit {facts['commit']}, {facts['date']}. {driver}; {facts['machine']}, {facts['cores']} cores"
        + (f"; {quiet.words}" if quiet else "")
        + ". Times of one table can be compared; those of other machines and days cannot."
    )


def page_of(title: str, how: str, said: str, found: Iterable[Table]) -> bytes:
    """Return a page with its title, the command ``how`` that writes it, the machine, and the tables."""
    mark = "<!-- not run: minutes of a quiet machine, or hours -->"
    text = [f"# {title}, measured", "", mark, "", f"    {how}        # wrote this page", "", fill(said, 99)]
    for name, about, table in found:
        text += ["", f"## {name}", "", fill(about, 99), "", f"<!-- table: {name} -->", "", table, "", "<!-- end -->"]
    return ("\n".join(text) + "\n").encode()


def main(pages: list[str], copies: bool, person: Path, minutes: float) -> None:
    FOLDER.mkdir(exist_ok=True)
    for page in [] if copies else pages or [*PAGES, "precision"]:
        text = written_precision(person, minutes) if page == "precision" else written(page)
        replace_file(FOLDER / f"{'work-precision' if page == 'precision' else page}.md", [text])
    for path in pages_with_copies():
        replace_file(path, [with_copies(path.read_text(encoding="utf-8")).encode()])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("pages", nargs="*", choices=[*PAGES, "precision", []])
    parser.add_argument("--copies", action="store_true")
    parser.add_argument("--person", type=Path, default=ROOT / "out" / "person.glb", help="see tools/docs/precision.py")
    parser.add_argument("--minutes", type=float, default=20.0, help="of precision: no scene begins later (default 20)")
    arguments = parser.parse_args()
    try:
        main(arguments.pages, arguments.copies, arguments.person, arguments.minutes)
    except GlsplatError as error:
        sys.exit(f"tools.docs.measured: {error}")
