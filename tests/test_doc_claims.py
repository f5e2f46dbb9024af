"""Numbers in README and docs that code knows: a page whose copy is old fails."""

from __future__ import annotations

import argparse
import pkgutil
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import glsplat
from apps import cli
from apps.serve.options import add_options
from glsplat.data import person
from glsplat.extras.authoring.reconstruct import Options
from glsplat.extras.evaluate.comparison import own_methods
from glsplat.extras.study.questionnaires import embedded
from glsplat.skinning.expression import ARKIT

pytestmark = [pytest.mark.check, pytest.mark.gl]

ROOT = Path(__file__).resolve().parents[1]
NUMBERS = {"two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "ten": 10, "eleven": 11}


def flags_of_serve() -> int:
    parser = argparse.ArgumentParser(add_help=False)
    add_options(parser)
    return sum(1 for action in parser._actions if action.option_strings)


def bytes_of(scene: glsplat.Splats | glsplat.Avatar) -> int:
    count = len(scene.splats if isinstance(scene, glsplat.Avatar) else scene)
    with glsplat.Renderer(scene, size=(16, 16), views=2) as renderer:
        renderer.render(glsplat.stereo_cameras(np.eye(4), ipd=0.06, size=(16, 16)))
        sizes = renderer.nbytes()
    return round((sum(sizes.values()) - sizes["targets"]) / count)


def static_bytes() -> int:
    n = 10240  # whole rows of 1024 splats
    means = np.random.default_rng(0).normal(size=(n, 3))
    turns, sizes = np.tile([1, 0, 0, 0], (n, 1)), np.full((n, 3), 0.01)
    return bytes_of(glsplat.Splats.create(means, turns, sizes, np.full(n, 0.9), rgb=np.full((n, 3), 0.5)))


CLAIMS: list[tuple[str, str, Callable[[], int]]] = [
    ("docs/performance.md", r"counts (\d+) bytes a splat for a static scene", static_bytes),
    ("docs/performance.md", r"surface,\s+takes (\d+)\.", lambda: bytes_of(person("anna"))),
    ("docs/frame.md", r"in two views takes (\d+) bytes", static_bytes),
    ("docs/gallery.md", r"^(\w+) programs of fewer", lambda: len(list((ROOT / "docs/examples").glob("*.py")))),
    ("docs/photo.md", r"steps of the fit \((\d+), about 12 s\)", lambda: Options().steps),
    ("docs/photo.md", r"`--splats N`, `--seed N` \| (\d+) and 0", lambda: Options().splats),
    ("docs/evaluation.md", r"fitted for (\d+) steps \(60 without", lambda: own_methods._STEPS),
    ("docs/faces.md", r"## The (\d+) shapes", lambda: len(ARKIT)),
    ("CHANGELOG.md", r"has SCENE and (\d+) flags", flags_of_serve),
]

UPLOADS = "glsplat.extras.uploads.job:UploadConfig(folder=None, make=None)"
LIMITS = "glsplat.net.guard.limits:Limits()"
SESSION = "glsplat.net.session:SessionConfig()"
SERVER = "glsplat.net.options:ServerConfig()"
LINK = "glsplat.extras.far_links"
CONSTANTS: dict[str, dict[str, str]] = {
    "protocol.md": {
        "UTF-8, at most # bytes": "glsplat.net.messages:MAX_MESSAGE_BYTES",
        "default port #.": f"{SERVER}.port",
        "pings every # s": f"{SERVER}.heartbeat",
        "after # s without a pong": f"{SERVER}.heartbeat / 2",
        "silent break within # s.": f"{SERVER}.heartbeat * 1.5",
        "`window=1..#`": "glsplat.net.options:MAX_WINDOW",
        "centre, up to #, and": "glsplat.net.options:_MAX_ROOM_DISTANCE_M",
        "(radius # m;": "glsplat.extras.rooms.room:RADIUS",
        "extrapolated for at most # ms, then held": "glsplat.extras.rooms.person:MAX_AHEAD_S * 1000",
        "fades from # s after": "glsplat.extras.rooms.person:SILENT_S",
        "invisible # s later": "glsplat.extras.rooms.person:FADE_S",
        "After # s without a message": f"{SESSION}.idle",
        "secret token of # characters": "glsplat.extras.rooms.room:_TOKEN_BYTES * 8 // 6 + 1",
        "list of up to # `[x, y, z]`": "glsplat.net.wire_schema:MAX_FACES",
        "Of more than # unsolved": "glsplat.net.pose_queue:_MAX_QUEUED",
        "own IPD (# m)": "glsplat.camera:PAPER_IPD",
        "field of view (#°)": "glsplat.camera:PAPER_FOV",
        "this server sends # x": "glsplat.net.codec.encoded:GRID_SIDE",
        "only the # oldest stay": "glsplat.net.pose_queue:_MAX_QUEUED_POSES",
        "recent pause, at most # ms": "glsplat/extras/browser/web/stream/pose.js:LATEST",
        "not taken within # s": f"{SERVER}.write_timeout",
        "# messages a second are read": f"{SESSION}.rate",
        "plus # in a burst": f"{SESSION}.burst",
        "# of it end the connection": f"{SESSION}.flood",
        "may send # frames a second": f"{LIMITS}.frames",
        "frames a second (# at once), ": f"{LIMITS}.frames_burst",
        "at once), # control frames": f"{LIMITS}.control",
        "control frames (#) and": f"{LIMITS}.control_burst",
        "(100) and # MiB": f"{LIMITS}.bytes / 2**20",
        "MiB (# MiB); one": f"{LIMITS}.bytes_burst / 2**20",
        "more than # s of each second": f"{LIMITS}.work",
        "of each second (# s while": f"{LIMITS}.work_alone",
        "beyond # samples a second": f"{LIMITS}.samples",
        "samples a second (# at once), only": f"{LIMITS}.samples_burst",
        "all of up to # characters": "glsplat.net.guard.limits:_SHORT_MESSAGE",
        "Above # s (`max-time`)": "glsplat.net.backends.gl:MAX_PICTURE_S",
        "always # pixels a splat and view": "glsplat.net.backends.scene_renderer:_MIN_SPLAT_PIXELS",
        "at least # times as long": "glsplat.net.pace.fair_queue:_LONG_RATIO",
        "(its seconds / #)": "glsplat.net.pace.fair_queue:_STALL_S",
        "at most # times the picture's time": "glsplat.net.pace.fair_queue:_MAX_REST_RATIO",
        "or was shown; 0 to #, required": "glsplat.net.messages:MAX_ARRIVAL_MS",
        "valid request within # s": f"{SESSION}.handshake",
        "More than # at once, or": f"{SESSION}.errors",
        "the close within # s": "glsplat.net.conversation:_FAREWELL_S",
        "is ended # s after": "glsplat.net.worker.connection:HANG_S",
        "JPEG, # x 192": "glsplat.extras.operations.previews:PORTRAIT_PX",
        "JPEG, at most # pixels": "glsplat.extras.operations.previews:MAX_PREVIEW_PX",
    },
    "protocol-extensions.md": {
        "the piece: # bytes": f"{LINK}.datagrams.packets:PIECE",
        "G = ⌈n / #⌉": f"{LINK}.datagrams.packets:_GROUP",
        "for one session, for # s": f"{LINK}.datagrams.offers:LASTS",
        "round trip of # ms or more": f"{LINK}.datagrams.way:LONG * 1000",
        "session of # pictures": f"{LINK}.datagrams.way:_GOOD",
        "allows # packets": f"{LINK}.datagrams.offers:_KNOCKS",
        "up to # tenths": f"{LINK}.datagrams.packets:_MOST * 10",
        "at most # broken pictures": f"{LINK}.datagrams.packets:_FAILS * 1000",
        "1 to # names": "glsplat.net.wire_schema:MAX_CODECS",
        "`joints`: at most #": "glsplat.extras.browser.web_format.read:MOST_JOINTS",
        "(# from `serve`)": "glsplat.extras.browser.feature:_MOST_JOINTS",
        "more than # MB a picture": f"{UPLOADS}.picture_bytes / 1e6",
        "or # MB in all": f"{UPLOADS}.body_bytes / 1e6",
        "below # kB a second": f"{UPLOADS}.rate / 1000",
        "of which # s are forgiven": f"{UPLOADS}.stall",
        "forgiven, or more than # s": f"{UPLOADS}.receive_timeout",
        "more than # `POST /avatars`": f"{LIMITS}.uploads_burst",
        "plus one every # s": f"{LIMITS}.uploads ** -1",
        "holds # avatars": f"{UPLOADS}.max_avatars",
        "in at most # s.": f"{UPLOADS}.make_timeout",
        "until # minutes after the end": "glsplat.extras.uploads.job_queue:_KEEP_ENDED_S / 60",
    },
    "study.md": {
        "write # MiB at once": "glsplat.extras.study.serving.live:BURST_BYTES / 2**20",
        "and # KiB a second": "glsplat.extras.study.serving.live:RATE_BYTES_S / 1024",
        "ends at # MiB": "glsplat.extras.study.serving.live:MAX_LOG_BYTES / 2**20",
        "end at # GiB": "glsplat.extras.study.serving.recording:MAX_BYTES / 2**30",
        "less than # MiB": "glsplat.extras.study.serving.recording:MIN_FREE_BYTES / 2**20",
        "averaged over # draws": "glsplat.extras.study.analysis.anova:DRAWS",
        "up to # conditions": "glsplat.extras.study.analysis.plain:MOST_CONDITIONS",
        "gamma of #": "glsplat.extras.study.serving.lead:_GAMMA",
    },
    "watermark.md": {
        "tile of # x": "glsplat.extras.watermark.pattern:TILE",
        "mean square is # level": "glsplat.extras.watermark.mark:LEVELS[0]",
        "of 255 on black and # on": "glsplat.extras.watermark.mark:LEVELS[1]",
        "searches each # pictures": "glsplat.extras.watermark.detect:WINDOW",
        "scale between # and 2": "glsplat.extras.watermark.detect:SCALES[0]",
    },
    "speech.md": {
        "Sound of # to": "glsplat.extras.speech.analysis:MIN_RATE_HZ / 1000",
        "to # kHz": "glsplat.extras.speech.analysis:MAX_RATE_HZ / 1000",
        "moves by more than #,": "glsplat/extras/speech/web/voice/voice.js:LEAP",
        "at most every # ms": "glsplat/net/web/show/viewer.js:APART",
        "(not below #)": "glsplat/extras/speech/web/voice/panel.js:LEAST",
    },
    "webgl.md": {
        "room would be # times as fast": "glsplat/extras/browser/web/draw/choice.js:GAIN",
        "frames stay below # of their rate": "glsplat/extras/browser/web/draw/choice.js:SHARE",
        "for # s, and": "glsplat/extras/browser/web/draw/choice.js:PATIENCE / 1000",
        "retried after # s": "glsplat/extras/browser/web/avatar/cache.js:PAUSE / 1000",
        "R32F texture, # floats": "glsplat/extras/browser/web/draw/drawing.js:RECORD_ROW",
        "textures of #,": "glsplat/extras/browser/web/draw/device.js:WIDEST",
    },
    "tracking.md": {
        "at most # rad/s a joint": "glsplat.tracking.config:TrackerConfig().joint_speed",
        "a jump over # m": "glsplat.tracking.config:TrackerConfig().teleport",
        "# s without samples": "glsplat.tracking.config:TrackerConfig().gap",
        "a jump for # s": "glsplat.tracking.solve.height_limit:MAX_JUMP_S",
        "# times a second a GRU": "glsplat.extras.learned.network:RATE_HZ",
    },
    "scaling.md": {
        "then every # s": "glsplat.net.render_loop:_REVIVE_PERIOD_S",
        "with Ray after # s": "glsplat.extras.workers.pool:_HEADLESS_S",
        "every client # pictures a second": "glsplat.extras.workers.placement:QUICK ** -1",
        "is at most # times": "glsplat.extras.workers.placement:MUCH",
    },
    "conventions.md": {
        "more than # items": "glsplat.formats.scene_file:MAX_ITEMS",
        "more than # deep": "glsplat.formats.scene_file:_MAX_DEPTH",
        "a file above # MiB": "glsplat.formats.scene_file:_MAX_BYTES / 2**20",
        "quad ends at min(#,": "glsplat.config:MAX_SIGMA",
        "IPD # m.": "glsplat.camera:PAPER_IPD",
    },
    "formats.md": {"at most # are read": "glsplat.formats.gltf.levels:MAX_LEVELS"},
    "performance.md": {"cones keep # dB": "glsplat.config:CULL_PSNR"},
}
"""By page of docs: text around a number ("#"), and the code's: MODULE:NAME or FILE.js:NAME, then any arithmetic."""


def of_code(expression: str) -> float:
    name, rest = re.match(r"([\w./]+:\w+)(.*)", expression).groups()  # type: ignore[union-attr]
    path, _, constant = name.partition(":")
    if not path.endswith(".js"):
        return float(eval(f"it{rest}", {"it": pkgutil.resolve_name(name)}))
    text = (ROOT / path).read_text(encoding="utf-8")
    return float(eval(f"it{rest}", {"it": float(re.search(rf"^const {constant} = ([\d_.]+);", text, re.M)[1])}))  # type: ignore[index]


@pytest.mark.parametrize("page", CONSTANTS)
def test_numbers_are_the_constants_of_the_code(page: str) -> None:
    text, wrong = " ".join((ROOT / "docs" / page).read_text(encoding="utf-8").split()), []
    for words, expression in CONSTANTS[page].items():
        before, after = map(re.escape, words.split("#"))
        found = re.search(rf"{before}(\d(?:[\d ,.]*\d)?|\w+){after}", text)
        said = re.sub("[ ,]", "", found[1]) if found else "nan"
        number, true = float(NUMBERS.get(said, said)), of_code(expression)
        if not abs(number / true - 1) < 1e-9:
            wrong.append(f"{words}: {number:g}, in the code {true:g}")
    assert not wrong


@pytest.mark.parametrize(("page", "pattern", "true"), CLAIMS, ids=[f"{page}: {text}" for page, text, _ in CLAIMS])
def test_a_number_is_that_of_the_code(page: str, pattern: str, true: Callable[[], int]) -> None:
    found = re.search(pattern, (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None, f"{page} has no {pattern!r} any more: change the claim here"
    word = found[1].lower()
    assert (NUMBERS[word] if word in NUMBERS else int(word)) == true()


def test_the_sizes_of_the_extras_are_about_right() -> None:
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8").partition("## The extras")[2]
    said = {name: int(lines.replace(",", "")) for name, lines in re.findall(r"\*\*`(\w+)`\*\* \(([\d,]+)", text)}
    folder = ROOT / "glsplat/extras"
    true = {name: sum(len(file.read_bytes().splitlines()) for file in (folder / name).rglob("*.py")) for name in said}
    assert said == pytest.approx(true, rel=0.1, abs=60)
    assert {path.parent.name for path in folder.glob("*/__init__.py")} == set(said)


def test_every_command_has_its_place_in_the_docs() -> None:
    page = (ROOT / "docs/commands.md").read_text(encoding="utf-8")
    assert [name for name in cli.COMMANDS if f"`glsplat {name}" not in page] == []


def test_the_questionnaires_of_the_docs_are_those_of_the_package() -> None:
    page = (ROOT / "docs/study.md").read_text(encoding="utf-8")
    section = page.partition("## Questionnaires")[2].partition("\n## ")[0]
    rows = [cell for line in section.splitlines() if line.startswith("| `") for cell in line.split("|")[1:2]]
    named = {name for cell in rows for name in re.findall(r"`([\w-]+)`", cell)}
    assert named == set(embedded())
