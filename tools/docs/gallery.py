"""Redraw the pictures of docs/gallery.md: run each example of docs/examples as a user would.

    python -m tools.docs.gallery [docs/images]

Look at every picture at full size.
"""

from __future__ import annotations

import runpy
import sys
import tempfile
from contextlib import chdir
from pathlib import Path

import cv2

from apps.demo import running_server
from glsplat.config import RenderConfig
from tools.docs.site.public import ROOT

PICTURES = {
    "one_picture": "picture.png",
    "stereo_pair": "pair.png",
    "two_people": "people.png",
    "walk_clip": "walk.mp4.png",
    "depth_picture": "depth.png",
    "levels_of_detail": "levels.png",
    "cutout": "cutout.png",
    "recolour": "recoloured.png",
    "custom_solver": "solved.png",
    "drive_server": "served.jpg",
}
"""The picture that each of the ten programs writes, in the page's order."""
LARGEST = 60_000  # bytes
_SIDE = 960  # pixels, the longer one


def run(name: str, *arguments: str) -> None:
    """Run one example in the current folder, as ``python NAME.py ARGUMENTS``."""
    old, sys.argv = sys.argv, [name, *arguments]
    try:
        runpy.run_path(str(ROOT / "docs" / "examples" / f"{name}.py"), run_name="__main__")
    finally:
        sys.argv = old


def shrunk(picture: Path) -> bytes:
    """Return the picture as WebP of at most LARGEST bytes, transparent parts over white."""
    image = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    if image.shape[2] == 4:
        alpha = image[..., 3:] / 255
        image = (image[..., :3] * alpha + 255 * (1 - alpha)).round().astype("uint8")
    scale = min(1.0, _SIDE / max(image.shape[:2]))
    image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for quality in range(92, 20, -6):
        _, data = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])
        if len(data) <= LARGEST:
            return data.tobytes()
    raise SystemExit(f"{picture.name} does not fit into {LARGEST} bytes")


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "docs" / "images").resolve()
    with tempfile.TemporaryDirectory() as place, chdir(place), running_server(None, RenderConfig()) as url:
        for name, picture in PICTURES.items():
            run(name, *([url] if name == "drive_server" else []))
            data = shrunk(Path(picture))
            (folder / f"gallery-{name.replace('_', '-')}.webp").write_bytes(data)
            print(f"gallery-{name.replace('_', '-')}.webp: {len(data)} bytes")


if __name__ == "__main__":
    main()
