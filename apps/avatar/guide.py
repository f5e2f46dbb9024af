"""``glsplat avatar guide``: write a picture that explains how to take the photograph for an avatar."""

from __future__ import annotations

import argparse
from importlib import resources
from pathlib import Path

import cv2
import numpy as np

from ..output import save_png
from ..usage import output_kind


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("-o", "--out", default="guide.png", help="picture to write (.png; default %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Write the embedded picture."""
    output_kind("--out", args.out, (".png",), "a picture (.png)")
    data = np.frombuffer((resources.files("glsplat.data") / "photo-guide.webp").read_bytes(), np.uint8)
    picture = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
    save_png(Path(args.out), picture[..., ::-1])
    print(f"{args.out}: how to take the photograph, {picture.shape[1]} x {picture.shape[0]} pixels")
    return 0
