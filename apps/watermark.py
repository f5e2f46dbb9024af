"""``glsplat watermark``: find the watermark of a server in its pictures."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.photo.photo_file import MAX_PIXELS
from glsplat.extras.authoring.video.film import each_frame, is_video
from glsplat.extras.watermark.detect import WINDOW, detect
from glsplat.extras.watermark.keys import WATERMARK, read_watermark
from glsplat.io.files import open_regular
from glsplat.net.guard.state_dir import state_folder

from .args import whole
from .usage import UsageError

HELP = "Find the invisible watermark in pictures of `glsplat serve`, which identifies the session."
EXAMPLE = "glsplat watermark detect leaked.mp4"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands and their options."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    finder = commands.add_parser(
        "detect", help="print server and session of a clip, or of pictures of one size; exit code 1 without a mark"
    )
    finder.add_argument("files", nargs="+", type=Path, metavar="FILE", help="a clip, or pictures (PNG, JPEG, WebP)")
    finder.add_argument(
        "--key",
        type=Path,
        metavar="FILE",
        help="key file of the server (default: the one that this user's `glsplat serve` made)",
    )
    finder.add_argument(
        "--window", type=whole(1), default=WINDOW, metavar="N", help=f"pictures searched at once (default {WINDOW})"
    )
    finder.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Run the chosen action; return 0 if a mark was found, else 1."""
    key = read_watermark(state_folder() / WATERMARK if args.key is None else args.key).key
    seen = 0

    def counted() -> Iterator[NDArray[np.uint8]]:
        nonlocal seen
        for picture in _pictures(args.files):
            seen += 1
            yield picture

    found = detect(counted(), key, args.window)
    if args.json:
        fields = {} if found is None else {"server": f"{found.server:04x}", "session": f"{found.session:08x}"}
        facts = {} if found is None else {"chance": found.chance, "scale": found.scale, "pictures": found.frames}
        print(json.dumps({"found": found is not None, **fields, **facts, "seen": seen}))
    elif found is None:
        print(f"no mark of this key in {seen} pictures")
    else:
        print(f"{found}, in {found.frames} pictures at scale {found.scale:.3f}")
    return 0 if found is not None else 1


def _pictures(files: list[Path]) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures [H, W, 3] RGB of a clip, or of each file. Raises FormatError or UsageError."""
    if is_video(files[0]):
        if len(files) > 1:
            raise UsageError(f"give one clip at a time, or pictures; found {files[0]} and {len(files) - 1} more")
        yield from each_frame(files[0])
        return
    for path in files:
        with open_regular(path) as (file, _):
            data = np.frombuffer(file.read(), np.uint8)
        try:
            picture = cv2.imdecode(data, cv2.IMREAD_COLOR)
        except cv2.error:
            picture = None
        if picture is None or picture.shape[0] * picture.shape[1] > MAX_PIXELS:
            raise FormatError(f"{path}: expected a clip, or a picture of at most {MAX_PIXELS // 10**6} megapixels")
        yield np.ascontiguousarray(picture[..., ::-1])
