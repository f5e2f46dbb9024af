"""Captures of the participants, their true masks, and the same people posed and seen otherwise."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from glsplat.camera import Camera
from glsplat.data import participants_folder
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.geometry.raster import mesh_picture, visible_faces
from glsplat.extras.authoring.models import store
from glsplat.extras.authoring.models.catalogue import PHOTO
from glsplat.extras.formats.person import read_person
from glsplat.skinning.pose import Pose
from tests.conftest import SHARED_DATA

__all__ = ["Capture", "capture", "needs_networks"]


def needs_networks() -> None:
    """Skip where the networks are not on this machine."""
    missing = [model.name for model in PHOTO.models if store.state_of(model) != "here"]
    if missing:
        pytest.skip(f"no {missing[0]} in {store.folder()}; glsplat models get")


class Capture:
    """One participant's picture, and what is true of it."""

    def __init__(self, folder: Path, name: str) -> None:
        self.picture = cv2.cvtColor(cv2.imread(str(folder / "capture" / f"{name}.jpg")), cv2.COLOR_BGR2RGB)
        facts: dict[str, Any] = json.loads((folder / "capture" / f"{name}.json").read_text())
        view = facts["camera"]
        k = [[view["fx"], 0, view["width"] / 2], [0, view["fy"], view["height"] / 2], [0, 0, 1]]
        self.camera = Camera(view["w2c"], k, view["width"], view["height"])
        self.mesh = read_person(folder / f"{name}.npz")
        self.light: dict[str, Any] = facts["light"]
        self.pose, self.trans = np.array(facts["pose"]), np.array(facts["trans"])
        self.mask = visible_faces(self.mesh, self.mesh.posed(Pose(self.pose, self.trans)), self.camera)[0] >= 0

    def joint(self, name: str) -> np.ndarray:
        """[2] pixels of a joint."""
        frames = self.mesh.skeleton.forward(self.pose, self.trans)
        point = frames[self.mesh.skeleton.names.index(name), :3, 3]
        x, y, z = self.camera.viewmat[:3, :3] @ point + self.camera.viewmat[:3, 3]
        return np.array([x / z, y / z]) * self.camera.K[0, 0] + self.camera.K[:2, 2]

    def skin(self) -> np.ndarray:
        """[V, 3] the open body's vertices in camera axes, metres; NaN where the person's body has no such skin."""
        body = open_body()
        part = next(part for part in self.mesh.parts if part.name == "body")
        owner = cKDTree(body.uv.reshape(-1, 2)).query(part.uv.reshape(-1, 2))[1]  # both have MakeHuman's texture map
        world = self.mesh.posed(Pose(self.pose, self.trans))[part.faces.ravel()]
        vertices = np.full(body.vertices.shape, np.nan)
        vertices[body.faces.ravel()[owner]] = world @ self.camera.viewmat[:3, :3].T + self.camera.viewmat[:3, 3]
        return vertices

    def room(self) -> np.ndarray:
        """The picture with its person painted over, coarsely."""
        size = self.picture.shape[1] // 4, self.picture.shape[0] // 4
        hidden = cv2.dilate(cv2.resize(self.mask.astype(np.uint8), size), np.ones((15, 15), np.uint8))
        small = cv2.inpaint(cv2.resize(self.picture, size), hidden, 5, cv2.INPAINT_TELEA)
        return cv2.resize(small, self.picture.shape[1::-1])

    def seen(self, **turns: tuple[float, float, float]) -> np.ndarray:
        """The person before the room with these joints turned (axis-angle), without light and shadow."""
        pose = self.pose.copy()
        for name, turn in turns.items():
            pose[self.mesh.skeleton.names.index(name)] = turn
        return self.shown(Pose(pose, self.trans))

    def shown(self, pose: Pose) -> np.ndarray:
        """The person before the room in a pose, without light and shadow."""
        drawn = mesh_picture(self.mesh, self.mesh.posed(pose), self.camera, 1)
        solid = drawn[..., 3:] > 0.5
        return np.where(solid, drawn[..., :3] * 255, self.room()).astype(np.uint8)


@cache
def capture(name: str) -> Capture:
    """A participant's capture, made once: an embedded one, else one beside the checkout; else the test is skipped."""
    own, beside = participants_folder(), SHARED_DATA / "participants"
    if not (own / f"{name}.npz").exists() and not beside.is_dir():
        pytest.skip(f"no reference data at {SHARED_DATA}")
    return Capture(own if (own / f"{name}.npz").exists() else beside, name)
