"""``glsplat page``: write a static page that shows an avatar in browsers and in VR, without ``glsplat serve``."""

from __future__ import annotations

import argparse
import json
import posixpath
import re
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.data import default_avatar, embedded_file
from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.browser.web_format.write import web_file
from glsplat.extras.consent.file import OnFile, on_file
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.formats.motion_files import embedded_motions, load_motion
from glsplat.io.files import replace_file
from glsplat.motion.motion import Motion
from glsplat.net.pages import page_files

from .args import load_avatar

HELP = (
    "Write a page that shows an avatar in any browser with WebGL 2 and in VR, with motions. Any file server will do "
    "(python -m http.server). Visitors can download the avatar's splats, so its consent record needs hand_out; the "
    "embedded avatar needs none."
)
EXAMPLE = "glsplat page me.glb -o out/page"

_START = "alone/main.js"
_IMPORT = re.compile(r"""(?:from|import)\s*\(?\s*'(\.[^']+)'""")
_AVATAR = "avatar.splats"
_DECIMALS = 5  # of radians and metres
_MAX_FRAMES = 20_000  # of a motion


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("avatar", nargs="?", metavar="AVATAR", help="avatar to show (default: the embedded one)")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("out/page"), metavar="FOLDER", help="output folder (default out/page)"
    )
    parser.add_argument(
        "--motion",
        action="append",
        metavar="FILE",
        help="motion to offer, a file or an embedded one; may be repeated (default: all embedded ones that fit)",
    )
    parser.add_argument("--name", help="name of the avatar on the page (default: the file's name)")


def run(args: argparse.Namespace) -> int:
    """Write the folder, index.html last. Raises GlsplatError before anything is written."""
    name = args.name or (Path(args.avatar).stem if args.avatar else "The embedded avatar")
    avatar = _agreed(args.avatar, name)
    motions = _motions(args.motion, avatar)
    files = dict(_files(avatar, name, motions))
    index = files.pop("index.html")
    try:
        for path in files:
            (args.output / path).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(f"{args.output}: cannot make the folder ({error.strerror})") from None
    for path, data in {**files, "index.html": index}.items():  # index.html last, when all its files exist
        replace_file(args.output / path, [data])
    size = sum(map(len, files.values())) + len(index)
    shown = ", ".join(motions) or "no motions"
    print(f"{args.output}: {len(files) + 1} files, {size / 1e6:.2f} MB; {shown}", file=sys.stderr)
    print(f"open it: python -m http.server --directory {args.output}", file=sys.stderr)
    return 0


def _agreed(path: str | None, name: str) -> Avatar:
    """Return the avatar. Raises GlsplatError unless its consent record allows handing out its splats."""
    policy = ConsentPolicy()
    if path is None:
        found, kept = default_avatar(), OnFile(nobody=True)
    else:
        figure = load_avatar(path, "AVATAR")
        if not isinstance(figure, Avatar):
            raise FormatError(f"{path}: expected an avatar of splats, found a mesh; make one with glsplat avatar make")
        found, kept = figure, on_file(embedded_file(path))
    policy.add(name, [kept])
    if why := policy.withheld(name, time.time()):
        raise GlsplatError(f"{why}; a page gives them to everybody (glsplat avatar consent --hand-out)")
    return found


def _motions(asked: list[str] | None, avatar: Avatar) -> dict[str, Motion]:
    """Return the motions by their label on the page. Embedded ones that do not fit are skipped with a notice."""
    found: dict[str, Motion] = {}
    for name in asked if asked is not None else embedded_motions():
        try:
            motion = load_motion(name, avatar.skeleton)
        except GlsplatError as error:
            if asked is not None:
                raise
            print(f"glsplat page: {name} is left out: {error}", file=sys.stderr)
            continue
        if len(motion) > _MAX_FRAMES:
            raise FormatError(f"{name}: a page takes motions of at most {_MAX_FRAMES} frames, not {len(motion)}")
        label = re.sub(r"[-_.]+", " ", Path(name).stem).strip().capitalize() or "Motion"
        found[label if label not in found else f"{label} {len(found) + 1}"] = motion
    return found


def _files(avatar: Avatar, name: str, motions: Mapping[str, Motion]) -> Iterator[tuple[str, bytes]]:
    """Yield (path, content) of each file in the folder."""
    web = page_files()
    for path in (*_modules(web), "alone/style.css", "alone/icon.svg", "draw/programs.json"):
        yield path, web[path]
    yield _AVATAR, web_file(avatar).data
    offered = []
    for number, (label, motion) in enumerate(motions.items()):
        offered.append({"label": label, "file": f"motions/{number}.json"})
        yield offered[-1]["file"], _json(baked(motion))
    yield "page.json", _json({"name": name, "avatar": _AVATAR, "credit": _credit(avatar), "motions": offered})
    html = web["alone/index.html"].decode()
    yield "index.html", html.replace("<head>", '<head>\n  <base href="alone/">', 1).encode()


def _modules(web: Mapping[str, bytes]) -> list[str]:
    """Return the paths of the page's script and of all its imports."""
    found, todo = set[str](), [_START]
    while todo:
        path = todo.pop()
        if path in found:
            continue
        found.add(path)
        text = web[path].decode()
        todo += [posixpath.normpath(posixpath.join(posixpath.dirname(path), one)) for one in _IMPORT.findall(text)]
    return sorted(found)


def baked(motion: Motion) -> dict[str, Any]:
    """Return a motion for track/drivers.js: axis-angle of this avatar's joints, and the root's translation."""
    frames = []
    for index in range(len(motion)):
        pose = motion.pose(index)
        frame: dict[str, Any] = {"joints_pose": _rounded(pose.rotations), "trans": _rounded(pose.trans)}
        if pose.translations is not None:
            frame["translations"] = _rounded(pose.translations)
        frames.append(frame)
    return {"fps": float(motion.fps), "frames": frames}


def _rounded(values: Any) -> Any:
    return (np.round(values, _DECIMALS) + 0.0).tolist()


def _credit(avatar: Avatar) -> str:
    """Return the source and the licence in the avatar's metadata."""
    said = [avatar.meta.get(key) for key in ("source", "licence")]
    return "; ".join(text for text in said if isinstance(text, str))[:300]


def _json(value: Any) -> bytes:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False).encode()
