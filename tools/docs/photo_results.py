"""Compare avatars of participants' photographs with the participants: tables of docs/photo.md, "Results".

    python -m tools.docs.photo_results [--steps N] [p01 p02 ...]
    python -m tools.docs.photo_results --poses "A-pose" "crossed" ... p14 p15

``--steps`` are those of fitting splats. Avatar and participant are drawn from four sides at 320 pixels, in the pose and
light of the participant's photograph. ``--poses`` renders a photograph in each pose, with the light and room of the
participant's own but no shadow on the floor; percentages compare LPIPS with the person's A-pose.
"""

from __future__ import annotations

import argparse
import json

import cv2
import numpy as np
from scipy.optimize import least_squares

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at
from glsplat.extras.authoring.check.capture import check_capture
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.authoring.photo.photo_file import read_photo
from glsplat.extras.authoring.reconstruct.builtin import Builtin
from glsplat.extras.authoring.reconstruct.reconstructor import Options, Picture
from glsplat.extras.evaluate.lpips import Lpips
from glsplat.extras.evaluate.metrics import l1, psnr, ssim
from glsplat.extras.evaluate.turntable import CaptureLight, shade_of
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from tests.conftest import SHARED_DATA
from tests.extras.authoring.captures import Capture, capture

SIZE = 320  # pixels
SIDES = (0, 90, 180, 270)  # degrees to the person's left
A_POSE, BAG, GLASSES = "A-pose", "a bag in a hand", "sunglasses"
MAX_TURN, BEND_SD = 4.0, 1.0  # degrees that a capture is turned and its joints are bent
DARK = (22, 20, 24)

_SIDES = {"left": 1.0, "right": -1.0}
_ARM = ("collar", "shoulder", "elbow", "wrist", "index", "middle", "pinky", "ring", "thumb")

# place of the wrist: across (in half widths of the hips, towards the arm's side), up (0: hips, 1: shoulders), metres
# before (negative: behind) the body's surface; then the elbow's direction
_Reach = tuple[float, float, float, tuple[float, float, float]]
_HIP: _Reach = (1.30, 0.13, 0.0, (1.0, 0.0, -0.35))
_POCKET: _Reach = (1.0, -0.12, 0.045, (0.7, 0.0, -0.8))
POSES: dict[str, tuple[dict[str, _Reach], float]] = {
    "arms at 3 degrees": ({}, 0.0),
    "crossed": ({"left": (-0.55, 0.52, 0.10, (0.8, -0.5, 0.1)), "right": (-0.55, 0.42, 0.05, (0.8, -0.5, 0.1))}, 0.0),
    "hands on hips": ({"left": _HIP, "right": _HIP}, 0.0),
    "hands at the pockets": ({"left": _POCKET, "right": _POCKET}, 0.0),
    "a hand on the belly": ({"left": (0.1, 0.25, 0.05, (1.0, -0.3, -0.2))}, 0.0),
    "a hand behind the back": ({"right": (0.2, 0.15, -0.06, (1.0, 0.0, -0.6))}, 0.0),
    "turned by 30": ({}, 30.0),
    "turned by 45, a hand on the belly": ({"right": (0.1, 0.25, 0.05, (1.0, -0.3, -0.2))}, -45.0),
}
"""Reach of arms by side, and degrees that the person has turned to their own left, by name. Other arms hang."""

_HANGING = 3.0  # degrees from vertical
_BESIDE = 0.045  # metres between a hanging wrist and the hips


def standing(person: Capture, name: str) -> Pose:
    """Return the pose ``name`` of POSES for a person's body."""
    reaches, turn = POSES[name]
    skeleton = person.mesh.skeleton
    rotations = np.zeros_like(person.pose)
    rest = skeleton.forward(rotations)[:, :3, 3]
    surface = _trunk(person)

    def at(joint: str) -> int:
        return skeleton.names.index(joint)

    for side, out in _SIDES.items():
        numbers = [at(f"{side}_{joint}") for joint in ("shoulder", "elbow", "wrist")]
        shoulder, elbow, wrist = rest[numbers]
        length = np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow)
        hips, middle = rest[at(f"{side}_hip")], rest[at("pelvis")]
        if side in reaches:
            across, up, before, looks = reaches[side]
            half = abs(surface[abs(surface[:, 1] - middle[1]) < 0.04, 0]).max()
            y = middle[1] + up * (shoulder[1] - middle[1])
            x = out * across * half
            near = surface[(abs(surface[:, 0] - x) < 0.06) & (abs(surface[:, 1] - y) < 0.08), 2]
            depth = hips[2] if not len(near) or before == 0 else (near.max() if before > 0 else near.min()) + before
            goal, hint = np.array([x, y, depth]), np.array(looks) * (out, 1, 1)
        else:
            low = shoulder[1] - 0.99 * length
            beside = abs(surface[abs(surface[:, 1] - low - 0.05) < 0.15, 0]).max() + _BESIDE
            x = max(abs(shoulder[0]) + length * np.sin(np.radians(_HANGING)), beside)
            goal, hint = np.array([out * x, low, shoulder[2] + 0.02]), np.array([0.5 * out, 0.0, -1.0])
        rotations[numbers[:2]] = _reaching(person, numbers, goal, hint, out)
    rotations[0] = (0.0, np.radians(turn), 0.0)
    return Pose(rotations, person.trans)


def _trunk(person: Capture) -> np.ndarray:
    """Return the dressed surface [N, 3] in the zero pose, without arms and head."""
    mesh = person.mesh
    owner = np.take_along_axis(mesh.joints, mesh.weights.argmax(axis=1)[:, None], 1)[:, 0]
    arms = np.array([any(part in name for part in (*_ARM, "neck", "head")) for name in mesh.skeleton.names])
    return mesh.posed(Pose(np.zeros_like(person.pose), np.zeros(3)))[~arms[owner]]


def _reaching(person: Capture, numbers: list[int], goal: np.ndarray, hint: np.ndarray, out: float) -> np.ndarray:
    """Return rotations [2, 3] of shoulder and elbow that bring the wrist to ``goal``, the elbow towards ``hint``."""
    skeleton, hint = person.mesh.skeleton, hint / np.linalg.norm(hint)

    def away(x: np.ndarray) -> np.ndarray:
        rotations = np.zeros_like(person.pose)
        rotations[numbers[0]], rotations[numbers[1], 1] = x[:3], x[3]
        shoulder, elbow, wrist = skeleton.forward(rotations)[numbers, :3, 3]
        bend = elbow - (shoulder + wrist) / 2
        return np.concatenate([(wrist - goal) * 100, 0.3 * (bend - (bend @ bend) ** 0.5 * hint) * 30, 0.1 * x[:3]])

    start = np.array([0.0, 0.0, -1.2 * out, -0.6 * out])
    limits = np.array([2.5, 2.5, 2.5, 2.6])
    low, high = -limits, limits.copy()
    low[3], high[3] = (-2.6, 0.0) if out > 0 else (0.0, 2.6)
    x = least_squares(away, start, bounds=(low, high), max_nfev=60).x
    return np.array([x[:3], [0.0, x[3], 0.0]])


def posed(person: Capture, pose: str, rng: np.random.Generator) -> Pose:
    """Return a pose of this name for the participant, with small random bends."""
    if pose in (A_POSE, GLASSES):
        taken = Pose(person.pose, person.trans)
    else:
        taken = standing(person, "arms at 3 degrees" if pose == BAG else pose)
    turns = (
        taken.rotations + np.radians(BEND_SD) * rng.normal(size=taken.rotations.shape) * (np.arange(55) < 22)[:, None]
    )
    turns[0] = taken.rotations[0] + (0.0, np.radians(rng.uniform(-MAX_TURN, MAX_TURN)), 0.0)
    return Pose(turns, taken.trans)


def photographed(person: Capture, pose: str, taken: Pose) -> np.ndarray:
    """Draw the lit participant before their room, RGB uint8; bags and glasses are painted on."""
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
            centre, axes = at(eye, (0.0, 0.0, 0.02)), (round(0.07 * scale), round(0.05 * scale))
            cv2.ellipse(picture, centre, axes, 0, 0, 360, DARK, -1, cv2.LINE_AA)
        ends = at("left_eye_smplhf"), at("right_eye_smplhf")
        cv2.line(picture, *ends, DARK, max(round(0.015 * scale), 1), cv2.LINE_AA)
    if pose == BAG:
        x, y = at("right_middle3")
        top, width, height = y + round(0.1 * scale), round(0.33 * scale), round(0.5 * scale)
        cv2.rectangle(picture, (x - width, top), (x + width, y + height), (120, 52, 40), -1)
        axes = round(0.18 * scale), round(0.12 * scale)
        cv2.ellipse(picture, (x, top), axes, 0, 180, 360, (80, 34, 26), 4, cv2.LINE_AA)
    return picture


def avatar_of(name: str, pose: str | None = None, steps: int = 0) -> Avatar | str:
    """Return the avatar of a participant's photograph, or of one drawn in ``pose``; on refusal the reasons."""
    folder = SHARED_DATA / "participants"
    people = json.loads((folder / "participants.json").read_text())["participants"]
    height = next(float(person["height_m"]) for person in people if person["id"] == name)
    if pose is None:
        photo = read_photo(folder / "capture" / f"{name}.jpg")
        picture, focal = photo.picture, photo.focal
    else:
        person = capture(name)
        rng = np.random.default_rng(int(name[1:]) * 100 + sum(map(ord, pose)))
        picture, focal = photographed(person, pose, posed(person, pose, rng)), float(person.camera.K[0, 0])
    seen = check_capture(picture)
    if seen.refused or seen.person is None:
        return "; ".join(f"{finding.code}: {finding.text}" for finding in seen.findings if finding.refusal)
    pictures = {"front": Picture(picture, focal, seen.person)}
    return Builtin().reconstruct(pictures, {"front": seen.mask}, Options(height=height, steps=steps))


def cameras_around(vertices: np.ndarray) -> list[Camera]:
    """Return cameras on ``SIDES`` of the person, who fills 88 % of the picture's height or width."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle, extent, focal = (low + high) / 2, float((high - low)[:2].max()), 1.37 * SIZE
    k = [[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1]]
    away = focal * extent / (0.88 * SIZE)
    eyes = [middle + away * np.array([np.sin(turn), 0, np.cos(turn)]) for turn in np.radians(SIDES)]
    return [Camera(look_at(eye, middle), k, SIZE, SIZE) for eye in eyes]


def measured(name: str, avatar: Avatar, network: Lpips) -> np.ndarray:
    """Return the means of L1, PSNR, SSIM and LPIPS over the four sides."""
    person = capture(name)
    pose = Pose(person.pose, person.trans)
    vertices = person.mesh.posed(pose)
    cameras = cameras_around(vertices)
    with Renderer(avatar, size=(SIZE, SIZE), views=len(cameras)) as renderer:
        drawn = renderer.render(cameras, pose)[..., :3] / 255.0
    shade = shade_of(person.mesh, vertices, CaptureLight.of_note(person.light))
    with MeshTruth(person.mesh, size=(SIZE, SIZE)) as renderer:
        truth = renderer.render(cameras, pose, shade=shade)[..., :3] / 255.0

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        return network.distance(network.features(a), network.features(b))

    pairs = list(zip(drawn, truth, strict=True))
    return np.array([np.mean([measure(a, b) for a, b in pairs]) for measure in (l1, psnr, ssim, distance)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[f"p{number:02d}" for number in range(1, 25)])
    parser.add_argument("--poses", nargs="+", choices=[A_POSE, *POSES, BAG, GLASSES], default=[])
    parser.add_argument("--steps", type=int, default=0)
    given = parser.parse_intermixed_args()
    network = Lpips("alex")
    usual: dict[str, float] = {}  # LPIPS of each person's A-pose
    print("| pose | person | L1 | PSNR dB | SSIM | LPIPS | against the A-pose's |\n|---|---|---|---|---|---|---|")
    for pose in given.poses or (None,):
        rows = {}
        for name in given.names:
            avatar = avatar_of(name, pose, given.steps)
            if isinstance(avatar, str):
                print(f"{name}, {pose or 'photograph'}: {avatar}", flush=True)
                continue
            rows[name] = measured(name, avatar, network)
            if pose == A_POSE:
                usual[name] = rows[name][3]
        if not rows:
            continue
        rows["mean"] = np.mean(list(rows.values()), axis=0)
        worse = [rows[name][3] / usual[name] - 1 for name in rows if name in usual]
        for name, row in rows.items():
            change = f"{np.mean(worse):+.0%}" if name == "mean" and worse else ""
            figures = f"{row[0]:.4f} | {row[1]:.2f} | {row[2]:.4f} | {row[3]:.4f} | {change}"
            print(f"| {pose or 'photograph'} | {name} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
