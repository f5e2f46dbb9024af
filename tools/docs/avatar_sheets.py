"""Draws docs/images/avatars.jpg and avatars-close.jpg anew: embedded people beside the meshes that they were made of.

    python -m tools.docs.avatar_sheets [--people FOLDER ...] [--images docs/images]

The folders have the archives that tools/data/persons.py names. Look at every picture.
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from apps.output import label, stack
from glsplat import Renderer
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import RenderConfig
from glsplat.data import person
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.evaluate.avatar_poses import SCORE_POSES, score_pose
from glsplat.extras.evaluate.avatar_score import score
from glsplat.extras.formats.person import read_person
from glsplat.meshes import RiggedMesh
from tools.data.persons import PEOPLE, furnished

U8 = NDArray[np.uint8]

SIDE, TILE = 512, 256  # pixels as drawn, and on the sheets
LIMIT = 400_000  # bytes
GREY = 0.35
CLOSE = (  # pose, joint that is looked at, from where beside it (metres), degrees
    ("T-pose", "head", (0.35, 0.05, 1.0), 26.0),
    ("T-pose", "right_middle1", (-0.1, 0.1, 0.6), 26.0),
    ("squat", "left_knee", (0.35, 0.15, 1.3), 36.0),
    ("arms overhead", "neck", (0.1, 0.0, 1.6), 36.0),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=Path, nargs="+", default=[Path("../shared/data/people")])
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    meshes = {name: mesh_of(name, options.people) for name in ("ben", "anna")}
    write(options.images / "avatars.jpg", sheet(person("ben"), meshes["ben"]))
    rows = [close(person(name), mesh) for name, mesh in meshes.items()]
    write(options.images / "avatars-close.jpg", np.concatenate(rows))


def mesh_of(name: str, folders: list[Path]) -> RiggedMesh:
    """What that person was made of."""
    path = next(folder / PEOPLE[name].archive for folder in folders if (folder / PEOPLE[name].archive).exists())
    return furnished(read_person(path), PEOPLE[name])[0]


def sheet(avatar: Avatar, mesh: RiggedMesh, views: int = 4) -> U8:
    """A row a pose; for each view the avatar, the mesh and four times their difference."""
    size = (SIDE, SIDE)
    rows: list[list[U8]] = []
    with MeshTruth(mesh, size=size, output="float32") as truth:
        exact = RenderConfig(output="float32", cull_hidden=False)
        with Renderer(avatar, size=size, config=exact, context=truth.context) as renderer:
            for one in score(renderer, truth, avatar, mesh, list(SCORE_POSES), views):
                if not rows or len(rows[-1]) == 3 * views:
                    rows.append([])
                words = f"{one.pose}: {one.body:.1f} dB", "mesh", "4 x difference"
                pictures = one.avatar, one.mesh, 4 * np.abs(one.avatar - one.mesh)
                rows[-1] += [label(tile(picture), text) for picture, text in zip(pictures, words, strict=True)]
    return stack(rows, gap=2)


def close(avatar: Avatar, mesh: RiggedMesh) -> U8:
    """Two rows of two views: plain, antialias, mesh."""
    size = (SIDE, SIDE)
    tiles = []
    with ExitStack() as opened:
        truth = opened.enter_context(MeshTruth(mesh, size=size, output="float32"))
        pair = [
            opened.enter_context(Renderer(avatar, size=size, config=config, context=truth.context))
            for config in (RenderConfig(output="float32", antialias=one) for one in (False, True))
        ]
        for name, joint, beside, fov in CLOSE:
            pose = score_pose(name, mesh.skeleton)
            bones = pose.bones(mesh.skeleton)[mesh.skeleton.names.index(joint)]
            target = bones[:3, :3] @ mesh.skeleton.joints[mesh.skeleton.names.index(joint)] + bones[:3, 3]
            view = Camera(look_at(target + beside, target), pinhole(*size, fov), *size, background=(GREY,) * 3)
            drawers: list[Renderer | MeshTruth] = [*pair, truth]
            tiles += [tile(drawer.render([view], pose)[0, ..., :3]) for drawer in drawers]
    return np.concatenate([np.concatenate(tiles[i : i + 6], axis=1) for i in (0, 6)])


def tile(picture: NDArray[np.floating]) -> U8:
    """At half size, 8 bits."""
    smaller = cv2.resize(np.clip(picture, 0, 1), (TILE, TILE), interpolation=cv2.INTER_AREA)
    return np.rint(smaller * 255).astype(np.uint8)


def write(path: Path, picture: U8) -> None:
    """As good a JPEG as fits."""
    for quality in range(88, 30, -6):
        encoded = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        if len(encoded) <= LIMIT:
            break
    path.write_bytes(encoded.tobytes())
    print(path, picture.shape, len(encoded) // 1024, "kB")


if __name__ == "__main__":
    main()
