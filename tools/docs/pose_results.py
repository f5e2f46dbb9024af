"""Draws captures of participants in other poses, makes avatars of them, and holds these against the participants.

    python -m tools.docs.pose_results [--poses "crossed" "hands on hips" ...] p14 p15 ...

For the table of docs/photo-results.md. Each capture is lit as the participant's own, without shadow on the floor, and
before the same room. The avatar (no steps of fitting splats, the height told) is driven into the A-pose and seen from
four sides of 320 pixels, so that all poses are held against one truth; percentages are of each person's own A-pose.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable

import cv2
import numpy as np

from glsplat.extras.authoring.check.capture import check_capture
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.authoring.reconstruct.builtin import Builtin
from glsplat.extras.authoring.reconstruct.reconstructor import Options, Picture
from glsplat.extras.evaluate.light import CaptureLight, shade_of
from glsplat.extras.evaluate.metrics.lpips import Lpips
from glsplat.extras.evaluate.metrics.pixels import l1, psnr
from glsplat.extras.evaluate.metrics.structure import ssim
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from tests.conftest import SHARED_DATA
from tests.extras.authoring.captures import Capture, capture
from tools.docs.filmed import SIZE, views_of
from tools.docs.poses import POSES, standing

A_POSE, BAG, GLASSES = "A-pose", "a bag in a hand", "sunglasses"
TURN, BEND = 4.0, 1.0  # degrees by which each capture is turned, at most, and each joint bent, one standard deviation
Measures = dict[str, float]


def posed(person: Capture, pose: str, rng: np.random.Generator) -> Pose:
    """The participant in a pose of this name, not quite still."""
    if pose in (A_POSE, GLASSES):
        taken = Pose(person.pose, person.trans)
    else:
        taken = standing(person, "arms at 3 degrees" if pose == BAG else pose)
    turns = taken.rotations + np.radians(BEND) * rng.normal(size=taken.rotations.shape) * (np.arange(55) < 22)[:, None]
    turns[0] = taken.rotations[0] + (0.0, np.radians(rng.uniform(-TURN, TURN)), 0.0)
    return Pose(turns, taken.trans)


def photographed(person: Capture, pose: str, taken: Pose) -> np.ndarray:
    """RGB uint8 of the lit participant before their room; bags and glasses are painted on."""
    camera = person.camera
    vertices = person.mesh.posed(taken)
    shade = shade_of(person.mesh, vertices, CaptureLight.of_note(person.light))
    with MeshTruth(person.mesh, size=(camera.width, camera.height)) as renderer:
        drawn = renderer.render([camera], taken, shade=shade)[0]
    room, solid = person.room(), visible_faces(person.mesh, vertices, camera)[0] >= 0
    soft = cv2.GaussianBlur(solid.astype(np.float32), (0, 0), 0.7)[..., None]
    picture = np.ascontiguousarray((soft * drawn[..., :3] + (1 - soft) * room).astype(np.uint8))

    frames = person.mesh.skeleton.forward(taken.rotations, taken.trans)

    def at(joint: str, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[int, int]:
        frame = frames[person.mesh.skeleton.names.index(joint)]
        point = camera.viewmat[:3, :3] @ (frame[:3, :3] @ offset + frame[:3, 3]) + camera.viewmat[:3, 3]
        x, y = point[:2] / point[2] * camera.K[0, 0] + camera.K[:2, 2]
        return round(x), round(y)

    scale = float(np.hypot(*np.subtract(at("left_hip"), at("left_knee"))))
    if pose == GLASSES:
        for eye in ("left_eye_smplhf", "right_eye_smplhf"):
            cv2.ellipse(
                picture,
                at(eye, (0.0, 0.0, 0.02)),
                (round(0.07 * scale), round(0.05 * scale)),
                0,
                0,
                360,
                (22, 20, 24),
                -1,
                cv2.LINE_AA,
            )
        cv2.line(
            picture,
            at("left_eye_smplhf"),
            at("right_eye_smplhf"),
            (22, 20, 24),
            max(round(0.015 * scale), 1),
            cv2.LINE_AA,
        )
    if pose == BAG:
        x, y = at("right_middle3")
        wide, high = round(0.33 * scale), round(0.5 * scale)
        cv2.rectangle(picture, (x - wide, y + round(0.1 * scale)), (x + wide, y + high), (120, 52, 40), -1)
        cv2.ellipse(
            picture,
            (x, y + round(0.1 * scale)),
            (round(0.18 * scale), round(0.12 * scale)),
            0,
            180,
            360,
            (80, 34, 26),
            4,
            cv2.LINE_AA,
        )
    return picture


def measured(name: str, pose: str, distance: Callable[[np.ndarray, np.ndarray], float]) -> Measures | str:
    """What the avatar of such a capture is like, or why there is none."""
    person = capture(name)
    rng = np.random.default_rng(int(name[1:]) * 100 + sum(map(ord, pose)))
    taken = posed(person, pose, rng)
    picture = photographed(person, pose, taken)
    seen = check_capture(picture)
    if seen.refused or seen.person is None:
        return "; ".join(f"{finding.code}: {finding.text}" for finding in seen.findings if finding.refusal)
    people = json.loads((SHARED_DATA / "participants" / "participants.json").read_text())["participants"]
    height = next(float(each["height_m"]) for each in people if each["id"] == name)
    shot = {"front": Picture(picture, float(person.camera.K[0, 0]), seen.person)}
    avatar = Builtin().reconstruct(shot, {"front": seen.mask}, Options(height=height, steps=0))
    still = Pose(person.pose, person.trans)
    vertices = person.mesh.posed(still)
    cameras = list(views_of(vertices).values())
    with Renderer(avatar, size=(SIZE, SIZE), views=len(cameras)) as renderer:
        drawn = renderer.render(cameras, still)[..., :3] / 255.0
    shade = shade_of(person.mesh, vertices, CaptureLight.of_note(person.light))
    with MeshTruth(person.mesh, size=(SIZE, SIZE)) as renderer:
        truth = renderer.render(cameras, still, shade=shade)[..., :3] / 255.0
    pairs = list(zip(drawn, truth, strict=True))
    measures = {"l1": l1, "psnr": psnr, "ssim": ssim, "lpips": distance}
    return {key: float(np.mean([measure(a, b) for a, b in pairs])) for key, measure in measures.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="+")
    parser.add_argument("--poses", nargs="*", default=[A_POSE, *POSES, BAG, GLASSES])
    given = parser.parse_intermixed_args()
    network = Lpips("alex")

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        return network.distance(network.features(a), network.features(b))

    own: dict[str, float] = {}
    print("| capture | people | L1 | PSNR dB | SSIM | LPIPS | against the A-pose's |\n|---|---|---|---|---|---|---|")
    for pose in given.poses:
        found: dict[str, Measures] = {}
        for name in given.names:
            one = measured(name, pose, distance)
            if isinstance(one, str):
                print(f"{name}, {pose}: {one}", flush=True)
            else:
                found[name] = one
        if pose == A_POSE:
            own = {name: one["lpips"] for name, one in found.items()}
        mean = {key: np.mean([one[key] for one in found.values()]) for key in ("l1", "psnr", "ssim", "lpips")}
        worse = np.mean([one["lpips"] / own[name] for name, one in found.items() if name in own]) - 1
        figures = f"{mean['l1']:.4f} | {mean['psnr']:.2f} | {mean['ssim']:.4f} | {mean['lpips']:.4f}"
        print(f"| {pose} | {len(found)} | {figures} | {worse:+.0%} |", flush=True)


if __name__ == "__main__":
    main()
