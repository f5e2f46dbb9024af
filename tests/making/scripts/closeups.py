"""Draws heads of avatars from photographs before and after their splats are fitted, for docs/avatars.md.

    python -m tests.making.scripts.closeups OUT.jpg [p01 p02 p05]

A row a person: colours alone, as where numba is not installed; everything; and the painted body that both are made of,
each from the front and from the side.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from unittest import mock

import cv2
import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.data import participants_folder
from glsplat.making.reconstruct.photos import check_photos, reconstruct, reconstruct_mesh
from glsplat.making.reconstruct.reconstructor import Options
from glsplat.mesh import MeshRenderer
from glsplat.meshes import RiggedMesh
from glsplat.renderer import Renderer

DRAWN, SHOWN = 1024, 420  # pixels a side
GREY = 128
SIDES = 0, 60  # degrees around
CUT = slice(DRAWN // 10, DRAWN)  # rows; above is nothing


def close_up(thing: Avatar | RiggedMesh) -> np.ndarray:
    """The head from both sides, side by side, BGR."""
    head = thing.skeleton.joints[thing.skeleton.names.index("head")] + (0, 0.07, 0.02)
    pictures = []
    kind = Renderer if isinstance(thing, Avatar) else MeshRenderer
    with kind(thing, size=(DRAWN, DRAWN)) as renderer:
        for around in np.radians(SIDES):
            eye = head + 0.75 * np.array([np.sin(around), 0.0, np.cos(around)])
            camera = Camera(look_at(eye, head), pinhole(DRAWN, DRAWN, 24), DRAWN, DRAWN)
            image = renderer.render([camera])[0].astype(np.float64)
            pictures.append(image[CUT, :, 2::-1] + (1 - image[CUT, :, 3:] / 255) * GREY)
    return np.hstack([cv2.resize(one, None, fx=SHOWN / DRAWN, fy=SHOWN / DRAWN, interpolation=3) for one in pictures])


def row(photograph: Path) -> np.ndarray:
    """Before, after and the painted body of one photograph."""
    shots = check_photos(photograph)
    with mock.patch("glsplat.making.reconstruct.sharp.available", return_value=False):
        before = reconstruct(shots, Options()).avatar
    things = before, reconstruct(shots, Options()).avatar, reconstruct_mesh(shots, Options()).mesh
    return np.hstack([close_up(thing) for thing in things])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("people", nargs="*", default=["p01", "p02", "p05"])
    options = parser.parse_args()
    rows = [row(participants_folder() / "capture" / f"{person}.jpg") for person in options.people]
    cv2.imwrite(str(options.out), np.clip(np.vstack(rows), 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main()
