"""A user's program under strict types: `make types` reads it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import glsplat

Matrix = NDArray[np.float32]


def cloud(count: int) -> glsplat.Splats:
    rng = np.random.default_rng(0)
    means = rng.normal(0.0, 0.3, (count, 3)).astype(np.float32)
    quats: list[list[float]] = [[1, 0, 0, 0]] * count
    return glsplat.Splats.create(means, quats, np.full((count, 3), 0.05), np.ones(count), rgb=rng.random((count, 3)))


def person() -> glsplat.Avatar:
    splats = cloud(50)
    rest = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    skeleton = glsplat.Skeleton(["hips", "chest"], np.array([-1, 0]), rest)
    skin = glsplat.Skin(np.zeros((len(splats), 1), np.int64), np.ones((len(splats), 1)))
    return glsplat.Avatar(splats, skeleton, skin, {"source": "made here"})


def eyes(head: Matrix, size: int) -> list[glsplat.Camera]:
    left, right = glsplat.stereo_cameras(head, ipd=np.float32(0.06), size=(size, size), background=[1, 1, 1])
    return [left, replace(right, near=0.1)]


def single(size: int) -> glsplat.Camera:
    view: Matrix = glsplat.look_at((0, 0, 3), np.zeros(3, np.float32)).astype(np.float32)
    return glsplat.Camera(view, glsplat.pinhole(size, size, 40.0).astype(np.float32), size, size, (0.0, 0.0, 0.0))


def moved(joints: int, step: int) -> glsplat.Pose:
    rotations: Matrix = np.zeros((joints, 3), np.float32)
    rotations[1, 2] = 0.1 * step
    return glsplat.Pose(rotations, [0.0, 0.0, 0.01 * step])


def main(folder: Path) -> int:
    avatar, size = person(), 32
    config = glsplat.RenderConfig(output="uint8", sh_degree=0)
    glsplat.save(avatar, folder / "person.glb")
    scene: glsplat.Splats | glsplat.Avatar | glsplat.RiggedMesh | glsplat.Scene = glsplat.load(folder / "person.glb")
    pose = glsplat.Pose.from_smplx({"global_orient": np.zeros(3, np.float32), "transl": [0.0, 0.0, 0.0]})
    head: Matrix = np.eye(4, dtype=np.float32)
    head[2, 3] = 3.0
    total = 0
    context = glsplat.create_context()
    with glsplat.Renderer(scene, size=(size, size), views=2, config=config, context=context) as renderer:
        for step in range(3):
            pair: NDArray[np.uint8] = renderer.render(eyes(head, size), moved(2, step))
            picture: NDArray[np.uint8] = glsplat.straight(pair, background=(1, 1, 1))
            total += int(picture[..., 3].astype(np.int64).sum())
        images, depths = renderer.render(eyes(head, size), depth=True)
        metres: NDArray[np.float32] = depths
        total += int(images.sum()) + int(metres.max())
    exact = glsplat.RenderConfig(output="float32")
    with glsplat.Renderer(scene, size=(size, size), config=exact, context=context) as renderer:
        floats: NDArray[np.float32] = renderer.render([single(size)])
        into = renderer.render([single(size)], out=np.empty((1, size, size, 4), np.float32))
        total += int(floats.sum() + into.sum())
    context.release()
    try:
        glsplat.load(folder / "nothing.ply")
    except glsplat.GlsplatError as error:
        print(error)
    counts: dict[str, int] = {"splats": len(avatar.splats), "joints": len(avatar.skeleton), "pose": len(pose.rotations)}
    print(counts, avatar.skin.influences, repr(single(size)), avatar.splats.means.dtype, total > 0)
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
