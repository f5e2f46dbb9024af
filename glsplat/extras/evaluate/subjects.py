"""Subjects of a report: scenes with cameras, motion and reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.data import default_avatar, embedded_file
from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.evaluate.frames import FOV
from glsplat.extras.formats.person import read_person
from glsplat.formats import load_splats
from glsplat.formats.camera_file import load_cameras
from glsplat.formats.motion_files import load_motion
from glsplat.motion.motion import Motion
from glsplat.scene import Content
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats
from glsplat.views import orbited, view_of, viewing_point

NUDGE = 1e-6
"""Radians that a given camera turns in every second frame, invisibly, so that every frame is sorted.

Errors are measured in the frames between, with exactly the given camera: a turn makes near ties of equal depths, which
rounding decides.
"""

PERSON_SPLATS = 8000


@dataclass(frozen=True, eq=False)
class Subject:
    """A scene with its cameras and motion."""

    name: str
    scene: Splats | Avatar
    size: int  # side of each view in pixels; the longer side of a given camera
    moving: bool = False
    cameras: tuple[Camera, ...] = ()  # fixed ones; none: a pair that orbits by a degree per frame
    right: Splats | Avatar | None = None  # scene of the reference pictures, if another one

    def views(self, frame: int) -> list[Camera]:
        """Return the cameras of a frame."""
        if not self.cameras:
            return orbit(self.scene, frame, self.size)
        if frame % 2 == 0:
            return list(self.cameras)
        cosine, sine = np.cos(NUDGE), np.sin(NUDGE)
        turn = np.array([[cosine, 0, sine, 0], [0, 1, 0, 0], [-sine, 0, cosine, 0], [0, 0, 0, 1.0]])
        return [replace(camera, viewmat=turn @ camera.viewmat) for camera in self.cameras]

    def pose(self, frame: int) -> Pose | None:
        """Return the pose of a frame (``pose_of_frame``); None for a static subject."""
        if not isinstance(self.scene, Avatar) or not self.moving:
            return None
        return pose_of_frame(self.scene.skeleton, frame)


def pose_of_frame(skeleton: Skeleton, frame: int) -> Pose:
    """Return a pose of the embedded wave-and-turn at 30 frames per second; on other rigs all joints sway."""
    motion = _motion(skeleton)
    if motion is None:
        return Pose(np.full((len(skeleton), 3), 0.3 * np.sin(0.1 * frame)), np.zeros(3))
    return motion.at(frame / 30)


def orbit(scene: Content, frame: int, size: int) -> list[Camera]:
    """Return the pair of cameras of a head that orbits by a degree per frame, as in ``glsplat bench``."""
    eye, target = _viewing_point(scene)
    return view_of(orbited(eye, target, np.radians(frame)), target, (size, size), FOV, ipd=0.055)


def subjects_of(path: str | None, size: int, cameras: Sequence[str] = ()) -> list[Subject]:
    """Return the subjects of a scene file (None: the default avatar): static, and an avatar also in motion.

    ``cameras`` as in ``cameras_for``. An .npz is a rigged person (``dense_person``). Raises FormatError.
    """
    if path is not None and Path(path).suffix.lower() == ".npz":
        return [dense_person(Path(path), PERSON_SPLATS, size)]
    path = None if path is None else str(embedded_file(path))
    if path is not None and not Path(path).exists():
        raise FormatError(f"{path}: no such file; give a PLY, .splat or glTF")
    scene = default_avatar() if path is None else load_splats(path)
    name = "default avatar" if path is None else Path(path).name
    file = cameras_for(Path(path), cameras) if path is not None else None
    if file is not None:
        views = load_cameras(file)
        scale = min(1.0, size / max(views[0].width, views[0].height))
        views = [v.resized(max(1, round(v.width * scale)), max(1, round(v.height * scale))) for v in views]
        return [Subject(name, scene, size, cameras=tuple(views))]
    if isinstance(scene, Avatar):
        moves = "its joints swaying" if why_not_driven(scene.skeleton) else "in motion"
        return [Subject(f"{name}, static", scene.splats, size), Subject(f"{name}, {moves}", scene, size, moving=True)]
    return [Subject(name, scene, size)]


def cameras_for(scene: Path, given: Sequence[str]) -> Path | None:
    """Return a scene's camera file: ``NAME=FILE`` of ``given``, NAME.camera.json beside it or in a given folder."""
    named = [text.partition("=")[2] for text in given if text.startswith(f"{scene.stem}=")]
    folders = [Path(text) for text in given if "=" not in text]
    inside = [folder / f"{scene.stem}.camera.json" for folder in folders]
    places = [*map(Path, named), scene.with_suffix(".camera.json"), *inside]
    return next((place for place in places if place.exists()), None)


def check_cameras(given: Sequence[str], scenes: Sequence[str]) -> None:
    """Raise FormatError unless each is a folder or NAME=FILE with an existing file and the name of a scene."""
    for text in given:
        name, equals, file = text.partition("=")
        if not equals and not Path(text).is_dir():
            raise FormatError(f"{text}: --cameras takes a folder of NAME.camera.json files, or NAME=FILE for one scene")
        if equals and not Path(file).is_file():
            raise FormatError(f"{file}: no such camera file (given for {name})")
        if equals and name not in {Path(scene).stem for scene in scenes}:
            raise FormatError(f"{text}: no scene is called {name}; give its file's name without the ending")


def dense_person(path: Path, count: int, size: int) -> Subject:
    """Return a rigged person as an avatar with eight joints per splat; its reference has all joints.

    The reference has the weights of the nearest surface point: of its triangle's corners, which have four joints each.
    """
    # imported here: ``glsplat selftest`` has no SciPy
    from glsplat.extras.authoring.geometry.surface_points import nearest_weights
    from glsplat.extras.authoring.sample.surface import make_avatar

    mesh = read_person(path)
    avatar = make_avatar(mesh, count)
    joints, weights, _ = nearest_weights(mesh, avatar.splats.means.astype(np.float64))
    most = int((weights > 0).sum(axis=1).max())
    order = np.argsort(-weights, axis=1, kind="stable")[:, :most]
    ids = np.take_along_axis(joints, order, axis=1)
    kept: NDArray[np.float64] = np.take_along_axis(weights, order, axis=1)
    kept /= kept.sum(axis=1, keepdims=True)
    eight = Skin.create(ids, kept, len(mesh.skeleton), influences=8)
    dense = Skin(ids.astype(np.uint16), kept.astype(np.float32))
    return Subject(
        f"{path.name}, {'its joints swaying' if why_not_driven(mesh.skeleton) else 'in motion'}",
        Avatar(avatar.splats, mesh.skeleton, eight),
        size,
        moving=True,
        right=Avatar(avatar.splats, mesh.skeleton, dense),
    )


@lru_cache(maxsize=4)  # called every frame; its percentiles take milliseconds
def _viewing_point(scene: Content) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return viewing_point(scene, FOV)


@lru_cache(maxsize=4)
def _motion(skeleton: Skeleton) -> Motion | None:
    try:
        return load_motion("wave-and-turn", skeleton)
    except GlsplatError:
        return None
