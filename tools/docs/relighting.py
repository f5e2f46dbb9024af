"""Relighting measured: participants photographed lit from one side, their avatars relit from the other.

    python -m tools.docs.relighting FOLDER p05 p09 --out DIR

FOLDER has participants (docs/evaluation.md). Each is photographed by the captures' own generator (extras.evaluate.
turntable) with the lamp on one side, made into an avatar by the photograph alone, drawn from where it was photographed
and from 30 degrees to both sides, and compared with the mesh lit from the other side: without light, and under it.
L1 is in levels of 255 where either shows the person, LPIPS (alex) of the whole picture. A sheet of each goes to DIR.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from apps.output import save_png
from glsplat import Camera, Item, Pose, Renderer, Scene
from glsplat.extras.authoring.check.photos import check_photos
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.authoring.photo.photo_file import read_photo
from glsplat.extras.authoring.reconstruct.builtin import PHONE_FOCAL_FACTOR
from glsplat.extras.authoring.reconstruct.photos import reconstruct
from glsplat.extras.authoring.reconstruct.reconstructor import Options
from glsplat.extras.evaluate.comparison.participant import Participant, participants_in
from glsplat.extras.evaluate.light import CaptureLight, shade_of
from glsplat.extras.evaluate.metrics.lpips import Lpips
from glsplat.extras.evaluate.turntable import turntable
from glsplat.light import Light

F64 = NDArray[np.float64]

LAMP, COLOUR = (0.85, 0.55, 0.6), (0.75, 0.71, 0.66)
SIZE = 512, 768
HEAD = 4.5  # times nearer
GREY = (0.45, 0.45, 0.45)


def measure(participant: Participant, out: Path) -> dict[str, Any]:
    """L1 and LPIPS without and with relighting, a view each: as photographed, from both sides, the head.

    Also LPIPS of the avatar without light against the mesh in the photograph's light: what its shape alone costs.
    """
    assert participant.camera is not None and participant.pose is not None
    left = (-LAMP[0], *LAMP[1:])
    frame = next(
        iter(turntable(participant.mesh, participant.camera, participant.pose, left, COLOUR, frames=1, seed=3))
    )
    photo = out / f"{participant.name}_left.png"
    save_png(photo, frame.rgb)
    shots = check_photos(photo)
    made = reconstruct(shots, Options(height=participant.height))
    assert made.made is not None
    fitted = made.made.fit.views[0]
    focal = (read_photo(photo).focal or PHONE_FOCAL_FACTOR * max(frame.rgb.shape[:2])) * SIZE[1] / frame.rgb.shape[0]
    own = np.eye(4)
    own[:3, :3] = fitted.root
    own[:3, 3] = fitted.pelvis - fitted.root @ made.avatar.skeleton.joints[0]
    K = np.array([[focal, 0, SIZE[0] / 2], [0, focal, SIZE[1] / 2], [0, 0, 1]])
    light, as_taken = CaptureLight(LAMP, COLOUR), CaptureLight(left, COLOUR)
    rows, shape = [], []
    true = participant.camera.resized(*SIZE)
    vertices = participant.mesh.posed(frame.pose)
    bones = frame.pose.bones(participant.mesh.skeleton)
    names, joints = participant.mesh.skeleton.names, participant.mesh.skeleton.joints
    hips, head = (
        true.viewmat[:3, :3] @ (bones[j, :, :3] @ joints[j] + bones[j, :, 3]) + true.viewmat[:3, 3]
        for j in (0, names.index("head"))
    )
    from_world = own[:3, :3].T @ true.viewmat[:3, :3]  # the avatar's own axes; both share the camera's
    wanted = Light.hemisphere(light.sky, light.ground, from_world @ LAMP, np.multiply(COLOUR, np.pi))
    scene, net, sheet = Scene([Item(made.avatar)]), Lpips("alex"), []
    with (
        MeshTruth(participant.mesh, size=SIZE, supersample=2) as truth,
        Renderer(scene, size=SIZE) as renderer,
    ):
        for turn, near in ((0, 1.0), (30, 1.0), (-30, 1.0), (0, HEAD)):
            aim = true.K[:2, :2] @ (head[:2] / head[2]) + true.K[:2, 2]
            lens = np.array([[near, 0, SIZE[0] / 2 - near * aim[0]], [0, near, SIZE[1] / 2 - near * aim[1]], [0, 0, 1]])
            lens = np.eye(3) if near == 1 else lens
            up = true.viewmat[:3, 1]
            one = Camera(_turned(true.viewmat, hips, turn, up), lens @ true.K, *SIZE, background=GREY)
            other = Camera(_turned(own, fitted.pelvis, turn, up), lens @ K, *SIZE, background=GREY)
            goal = truth.render([one], frame.pose, shade=shade_of(participant.mesh, vertices, light))[0]
            pair = []
            for shone in (None, wanted):
                scene.light = shone
                pair.append(renderer.render([other], Pose(fitted.rotations))[0])
            kept = truth.render([one], frame.pose, shade=shade_of(participant.mesh, vertices, as_taken))[0]
            there = (goal[..., 3] > 0) | (pair[0][..., 3] > 0)
            wish = net.features(goal[..., :3].astype(np.float32) / 255)
            row = []
            for picture in pair:
                row.append(float(np.abs(picture[..., :3].astype(float) - goal[..., :3])[there].mean()))
                row.append(net.distance(net.features(picture[..., :3].astype(np.float32) / 255), wish))
            rows.append(row)
            seen, held = (net.features(picture[..., :3].astype(np.float32) / 255) for picture in (pair[0], kept))
            shape.append(net.distance(seen, held))
            sheet.append(np.concatenate([goal[..., :3], pair[0][..., :3], pair[1][..., :3]], axis=1))
    small = cv2.resize(frame.rgb, SIZE, interpolation=cv2.INTER_AREA)
    save_png(out / f"{participant.name}.png", np.concatenate([small, sheet[0], sheet[3]], axis=1))
    found = np.array(rows)
    gain = 1 - found[:, 2:] / found[:, :2]
    return {
        "name": participant.name,
        "l1": found[:, [0, 2]].round(2).tolist(),
        "lpips": found[:, [1, 3]].round(4).tolist(),
        "lpips_of_shape": np.round(shape, 4).tolist(),
        "nearer_l1": gain[:, 0].round(3).tolist(),
        "nearer_lpips": gain[:, 1].round(3).tolist(),
    }


def _turned(viewmat: F64, about: F64, degrees: float, up: F64) -> F64:
    """The viewmat of a camera that went round a point in its own space."""
    turn = cv2.Rodrigues(np.radians(degrees) * up)[0]
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = turn, about - turn @ about
    return step @ viewmat


def main() -> None:
    """Print a line of JSON a participant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for participant in participants_in(args.folder):
        if participant.name in args.names:
            print(json.dumps(measure(participant, args.out)), flush=True)


if __name__ == "__main__":
    main()
