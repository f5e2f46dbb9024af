"""Participants on a turntable, filmed, and the mesh or avatar made of it, drawn around them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.authoring.reconstruct.reconstructor import Options
from glsplat.extras.authoring.reconstruct.video import VideoResult, from_pictures
from glsplat.extras.evaluate.avatar_poses import SCORE_POSES, score_pose
from glsplat.extras.evaluate.turntable import Turntable, turntable
from glsplat.meshes import RiggedMesh
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from tests.conftest import SHARED_DATA
from tests.extras.authoring.captures import Capture, capture

SIZE = 320  # pixels
VIEWS = {"front": 0, "left": 90, "back": 180, "right": 270}  # degrees to the person's left
SHOWN = ("front", "left", "back")
FRAMES = 30


def views_of(vertices: np.ndarray) -> dict[str, Camera]:
    """Cameras around the person, who fills 88 % of the height."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle, extent, focal = (low + high) / 2, float((high - low)[:2].max()), 1.37 * SIZE
    k = [[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1]]
    away = focal * extent / (0.88 * SIZE)
    turns = {name: np.radians(degrees) for name, degrees in VIEWS.items()}
    eyes = {name: middle + away * np.array([np.sin(turn), 0, np.cos(turn)]) for name, turn in turns.items()}
    return {name: Camera(look_at(eye, middle), k, SIZE, SIZE) for name, eye in eyes.items()}


@dataclass(frozen=True, eq=False)
class Filming:
    """A participant's frames, and what was made of them."""

    person: Capture
    frames: list[Turntable]
    made: VideoResult

    def joints(self) -> float:
        """Millimetres between the body's joints in the frames and the truth, the pelvis held."""
        view, away = self.person.camera.viewmat[:3, :3], []
        for frame, seen in zip(self.made.frames, self.made.fit.views, strict=True):
            true = self.frames[int(frame.name.split()[1])].pose
            posed = self.person.mesh.skeleton.forward(true.rotations, true.trans)[:22, :3, 3] @ view.T
            away.append(np.linalg.norm((seen.joints[:22] - seen.joints[0]) - (posed - posed[0]), axis=1)[1:].mean())
        return float(np.mean(away) * 1000)

    def overlap(self) -> float:
        """Of the fitted body with the true masks."""
        return float(np.mean([seen.overlap for seen in self.made.fit.views]))


def filmed(name: str, frames: int = FRAMES, scale: float = 1.0, **words: Any) -> Filming:
    """The participant on a turntable, and the mesh of it."""
    folder = SHARED_DATA / "participants"
    light = json.loads((folder / "capture" / f"{name}.json").read_text())["light"]
    people = json.loads((folder / "participants.json").read_text())["participants"]
    height = next(float(each["height_m"]) for each in people if each["id"] == name)
    person, number = capture(name), int(name[1:])
    camera = person.camera.resized(round(person.camera.width * scale), round(person.camera.height * scale))
    turn = turntable(
        person.mesh,
        camera,
        Pose(person.pose, person.trans),
        light["direction_to"],
        light["colour"],
        frames=frames,
        turns=1 if number % 3 else -1,
        seed=number,
    )
    shown = list(turn)
    pictures = [(f"frame {index}", frame.rgb, None) for index, frame in enumerate(shown)]
    made = from_pictures(pictures, in_order=True, options=Options(height=height, **words), anyway=True)
    return Filming(person, shown, made)


def drawn(thing: RiggedMesh | Avatar, cameras: dict[tuple[str, str], Camera]) -> Iterator[np.ndarray]:
    """RGBA [H, W, 4] in [0, 1] of every pose and view."""
    opened: Any = (
        MeshTruth(thing, size=(SIZE, SIZE), output="float32")
        if isinstance(thing, RiggedMesh)
        else Renderer(thing, size=(SIZE, SIZE), views=1)
    )
    with opened as renderer:
        for (pose, _), camera in cameras.items():
            picture = renderer.render([camera], score_pose(pose, thing.skeleton))[0]
            yield picture / (255.0 if picture.dtype == np.uint8 else 1.0)


def compared(truth: list[np.ndarray], pictures: list[np.ndarray]) -> tuple[float, float]:
    """PSNR in dB over whole squares, and the figures' overlap, the means over all pictures."""
    level = [-10 * np.log10(((a[..., :3] - b[..., :3]) ** 2).mean()) for a, b in zip(truth, pictures, strict=True)]
    solid = [(a[..., 3] > 0.5, b[..., 3] > 0.5) for a, b in zip(truth, pictures, strict=True)]
    return float(np.mean(level)), float(np.mean([(a & b).sum() / (a | b).sum() for a, b in solid]))


def cameras_of(mesh: RiggedMesh) -> dict[tuple[str, str], Camera]:
    used = np.unique(mesh.faces)
    found = {}
    for pose in SCORE_POSES:
        around = views_of(mesh.posed(score_pose(pose, mesh.skeleton))[used])
        found |= {(pose, view): around[view] for view in SHOWN}
    return found
