"""Cameras around a person: the whole body, close-ups of head, hands and feet, other poses, and faces in expressions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at, pinhole
from glsplat.extras.authoring.geometry.visibility import EYES, GAZE_LIDS, HEAD
from glsplat.extras.authoring.optimize.refine import random_pose
from glsplat.skinning.pose import Pose

__all__ = ["FACE_ANGLES_DEG", "REVEALING", "Subject", "TargetView", "ViewConfig", "camera_around", "views_of"]

F64 = NDArray[np.float64]

_HEAD_ANGLES_DEG = (  # around and up
    *((-90, 0), (-50, 10), (-20, -8), (0, 5), (20, 15), (50, -5), (90, 5)),
    *((180, 10), (135, 25), (-135, 0), (0, 25), (0, -20)),
)
_HAND_ANGLES_DEG = ((0, 0), (180, 10), (20, 60), (0, -60))
_FOOT_ANGLES_DEG = ((0, 20), (180, 15), (90, 10), (-90, 10))
_HAND, _FOOT = ("wrist", "index", "middle", "pinky", "ring", "thumb"), ("ankle", "foot")
_CLOSE_UPS = (  # prefixes of the names of joints, and the angles
    (HEAD, _HEAD_ANGLES_DEG),
    *((tuple(f"{side}_{part}" for part in _HAND), _HAND_ANGLES_DEG) for side in ("left", "right")),
    *((tuple(f"{side}_{part}" for part in _FOOT), _FOOT_ANGLES_DEG) for side in ("left", "right")),
)
_EXPRESSIONS: tuple[dict[str, float], ...] = (  # others are close to one of these
    {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
    {"eyeBlinkLeft": 0.5, "eyeBlinkRight": 0.5, "browDownLeft": 0.7, "browDownRight": 0.7},
    {"jawOpen": 0.7},
    {"jawOpen": 0.35, "mouthFunnel": 0.6},
    {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0, "cheekSquintLeft": 0.6, "cheekSquintRight": 0.6},
    dict.fromkeys(("mouthUpperUpLeft", "mouthUpperUpRight", "mouthLowerDownLeft", "mouthLowerDownRight"), 0.7),
    {"mouthPucker": 1.0, "browInnerUp": 0.8},
    {"jawOpen": 0.5, "tongueOut": 1.0, "eyeWideLeft": 0.8, "eyeWideRight": 0.8},
)
REVEALING = _EXPRESSIONS[0], _EXPRESSIONS[2]  # lids, teeth and tongue
FACE_ANGLES_DEG = ((0, 0), (-35, 5), (35, -5))
_MIN_HALF_TAN = 1e-3  # tangent of half an angle of view, for a hand of a single splat


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewConfig:
    """Number and size of the pictures."""

    body: int = 24  # pictures from around, in the zero pose
    poses: int = 12  # random poses
    each: int = 2  # pictures of each random pose
    size: int = 768  # pixels a side of a whole body
    close: int = 384  # pixels a side of a head, a hand or a foot, and of a face with an expression
    elevations: tuple[float, ...] = (-12, 8, 30)  # degrees of cameras around the zero pose, in turn
    elevation_spread: float = 15.0  # degrees, standard deviation for other poses


class TargetView(NamedTuple):
    """A camera and the points it frames."""

    camera: Camera
    points: F64
    pose: Pose | None


class Subject(NamedTuple):
    """The subject of the pictures: P points of a mesh or of splats."""

    names: tuple[str, ...]  # of the joints
    points: F64  # [P, 3] in the zero pose
    strongest: NDArray[np.integer]  # [P] the joint that moves a point most
    posed: Callable[[Pose], NDArray[np.floating]]  # [P, 3]
    regions: Mapping[str, NDArray[np.bool_]] = MappingProxyType({})  # [P] of a face with expressions


def views_of(subject: Subject, rng: np.random.Generator, config: ViewConfig) -> Iterator[TargetView]:
    """Yield the views of the subject: from around, close-ups, expressions, and random poses."""
    names, points, strongest, posed_points, regions = subject
    for k in range(config.body):
        up = config.elevations[k % len(config.elevations)]
        yield TargetView(camera_around(points, 360 * k / config.body, up, config.size, 3.0), points, None)
    for wanted, sides in _CLOSE_UPS:
        some = points[np.array([name.startswith(wanted) for name in names])[strongest]]
        for around, up in sides if len(some) else ():
            yield TargetView(camera_around(some, around, up, config.close, 1.5), some, None)
    if any(mine.any() for mine in regions.values()):
        yield from _faces(subject, config)
    for k in range(config.poses):
        pose = random_pose(names, rng)
        posed = np.asarray(posed_points(pose), np.float64)
        for j in range(config.each):
            turned = 360 * (k / config.poses + j / config.each) + rng.uniform(-15, 15)
            up = float(rng.normal(5, config.elevation_spread))
            yield TargetView(camera_around(posed, turned, up, config.size, 3.0), posed, pose)


def _faces(subject: Subject, config: ViewConfig) -> Iterator[TargetView]:
    """Yield views of each expression and gaze: the face from three sides, lids and lips closer."""
    joints = len(subject.names)
    still = np.zeros((joints, 3))
    poses = [Pose(still, expression=one) for one in _EXPRESSIONS]
    eyes = [subject.names.index(name) for name in EYES if name in subject.names]
    for turn, lids in GAZE_LIDS.items() if eyes else ():
        rotations = still.copy()
        rotations[eyes] = np.radians((*turn, 0))
        poses.append(Pose(rotations, expression=dict.fromkeys(lids, 1.0)))
    every = np.any(list(subject.regions.values()), axis=0)
    for index, pose in enumerate([None, *poses]):
        posed = subject.points if pose is None else np.asarray(subject.posed(pose), np.float64)
        for around, up in FACE_ANGLES_DEG:
            yield TargetView(camera_around(posed[every], around, up, config.close, 1.5), posed[every], pose)
        for number, mine in enumerate(subject.regions.values()):
            if mine.any():
                side = 0 if pose is None else (-25, 0, 25)[(index + number) % 3]
                yield TargetView(camera_around(posed[mine], side, 0, config.close, 1.5), posed[mine], pose)


def camera_around(points: F64, around: float, up: float, size: int, distance: float, fill: float = 0.94) -> Camera:
    """Return a camera ``around`` and ``up`` degrees from the front, whose picture the points ``fill``."""
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    turn, lift = np.radians((around, min(max(up, -80.0), 80.0)))
    towards = np.array([np.cos(lift) * np.sin(turn), np.sin(lift), np.cos(lift) * np.cos(turn)])
    away = max(distance, 1.5 * float(np.linalg.norm(points - middle, axis=1).max()))
    viewmat = look_at(middle + away * towards, middle)
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    half = max(float(np.abs(seen[:, :2] / seen[:, 2:]).max()), _MIN_HALF_TAN)
    return Camera(viewmat, pinhole(size, size, float(2 * np.degrees(np.arctan(half / fill)))), size, size)
