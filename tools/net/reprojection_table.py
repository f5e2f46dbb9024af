"""Late pictures put on a plane, or by a coarse depth, beside pictures drawn for the new eye: the tables of docs/vr.md.

    python -m tools.net.reprojection_table [--person anna] [--save FOLDER]      # some minutes

An eye looks from A; the picture is put back as the page does it (web/show/shaders.js: the same inverse depths, mesh and
two passes) and seen from B, where the truth is drawn, too. LPIPS (AlexNet) and PSNR in the box that either covers, over
grey; the angle by which hands are shown elsewhere; holes and what is too much as parts of what the truth covers.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import head_matrix
from glsplat.data import PEOPLE, person
from glsplat.extras.evaluate.metrics.lpips import Lpips
from glsplat.extras.evaluate.metrics.pixels import psnr
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.net.backends.depth import depth_grids
from glsplat.net.codec import depth as server
from glsplat.net.codec.encode import covered_box
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene
from glsplat.skinning.pose import Pose
from glsplat.tracking.recording import embedded_recording
from glsplat.tracking.sample import Sample, Transform
from glsplat.tracking.tracker import Tracker
from tools.net.picture_warp import Image, Points, View, Warper

F64 = NDArray[np.float64]

SIDE = 1024  # pixels of a square picture
DENSITY = 800  # pixels a unit of tangent where the truth is drawn: 14 a degree in the middle
MOST = 1.19  # tangent of what a headset shows to each side
GREY = 0.45
LATE = 7  # samples of 72 a second, by which a picture of a moving user is late
MOVES: dict[str, tuple[float, float, float]] = {  # metres aside and ahead, degrees to the left
    "3 cm aside": (0.03, 0, 0),
    "10 cm aside": (0.1, 0, 0),
    "10 cm ahead": (0, 0.1, 0),
    "turned by 5": (0, 0, 5),
}


@dataclass(frozen=True, slots=True)
class Case:
    """What stands where, and who looks."""

    name: str
    renderer: Renderer
    pose: Pose | None
    eye: F64
    box: F64  # [8, 3] corners of what is shown
    hands: F64  # [N, 3] joints of the hands that are looked at
    room: bool = False


def device(x: float, y: float, z: float, yaw: float = 0.0, pitch: float = 0.0) -> Transform:
    """What is tracked there, looking along -z, turned to the left and up by degrees."""
    a, b = (float(np.radians(angle)) / 2 for angle in (yaw, pitch))
    return x, y, z, np.cos(a) * np.sin(b), np.sin(a) * np.cos(b), -np.sin(a) * np.sin(b), np.cos(a) * np.cos(b)


def turned(*where: float) -> F64:
    """World from such a device."""
    seven = np.array(device(*where))
    return head_matrix(seven[:3], seven[3:])


def framed(eye: F64, box: F64, margin: float = 0.03) -> View:
    """As the page does: what is seen of a box; all that a headset shows where next to nothing is."""
    points = (np.c_[box, np.ones(len(box))] @ np.linalg.inv(eye).T)[:, :3]
    before = points[points[:, 2] < -0.05]
    x, y = before[:, 0] / -before[:, 2], before[:, 1] / -before[:, 2]
    left, right = max(-MOST, x.min() - margin), min(MOST, x.max() + margin)
    down, up = max(-MOST, y.min() - margin), min(MOST, y.max() + margin)
    if len(before) < len(points):
        left, right, down, up = -MOST, MOST, -MOST, MOST
    return View(eye, left, right, down, up)


def box_of(joints: F64) -> F64:
    """The corners of what stands around joints."""
    low, high = joints.min(0) - 0.12, joints.max(0) + 0.12
    return np.array([np.where([i & 1, i & 2, i & 4], high, low) for i in range(8)])


def plane(case: Case, view: View) -> Points:
    """Today's: web/space/placing.js."""
    ends = np.array([0.0, 1.0])
    uu, vv = np.meshgrid(ends, ends)
    rays, eye = view.rays(uu, vv) @ view.eye[:3, :3].T, view.eye[:3, 3]
    ahead = view.rays(np.array(0.5), np.array(0.5)) @ view.eye[:3, :3].T
    ahead /= np.linalg.norm(ahead)
    middle = case.box.mean(0)
    away = middle - eye
    level = float(np.hypot(away[0], away[2]))
    point, normal = middle, -away * (1, 0, 1) / max(level, 1e-9)
    if case.room or not (level > 0.5 and level > abs(away[1]) and away @ ahead > 0):
        point, normal = eye + ahead * (1.6 if case.room else 0.5), -ahead
    return ends, ends, ((point - eye) @ normal) / (rays @ normal)


def quarter(image: Image, z: NDArray[np.float32]) -> Points:
    """One point each 4 x 4 pixels: means of what is covered, in 255 steps, elsewhere as the server fills."""
    rows, columns = z.shape[0] // 4, z.shape[1] // 4
    there = (image[..., 3] > 127).reshape(rows, 4, columns, 4)
    inverse = np.where(there, 1 / np.maximum(z, 1e-3).reshape(there.shape), 0).sum((1, 3))
    count = there.sum((1, 3))
    grid = server.grid_of(np.divide(inverse, count, out=np.full(count.shape, np.nan), where=count > 0))
    return (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows, grid.metres()


class Judge:
    """What a late picture is worth beside the truth."""

    def __init__(self) -> None:
        self._lpips = Lpips("alex")

    def __call__(self, found: Image, truth: Image) -> tuple[float, float, float, float]:
        """PSNR, LPIPS, holes, too much."""
        x, y, w, h = covered_box(np.maximum(found, truth))
        part = np.s_[y : y + h, x : x + w]
        one, other = (np.minimum(i[..., :3] / 255 + GREY * (1 - i[..., 3:] / 255), 1)[part] for i in (found, truth))
        distance = self._lpips.distance(self._lpips.features(one), self._lpips.features(other))
        there, shown = truth[..., 3] > 127, found[..., 3] > 127
        parts = (there & ~shown).sum() / there.sum(), (shown & ~there).sum() / there.sum()
        return psnr(one, other), distance, float(parts[0]), float(parts[1])


def ways(case: Case, view: View, size: tuple[int, int]) -> tuple[Image, NDArray[np.float32], dict[str, Points]]:
    """The picture from A, its depth, and where each way puts it."""
    renderer, camera = case.renderer, view.camera(*size)
    renderer.resize(*size)
    images, depths = renderer.render([camera], case.pose, depth=True)
    image, z = images[0].copy(), depths[0].copy()
    (grid,) = depth_grids(renderer, [camera], case.pose)
    coarse = np.linspace(0, 1, grid.columns), np.linspace(0, 1, grid.rows), grid.metres()
    return image, z, {"plane": plane(case, view), "32 x 32": coarse, "a quarter": quarter(image, z)}


def off(case: Case, view: View, image: Image, z: NDArray[np.float32], points: Points, eye: F64) -> float:
    """Degrees, median, by which ``eye`` sees hands elsewhere."""
    y, x = np.nonzero(image[..., 3] > 200)
    u, v = (x + 0.5) / image.shape[1], (y + 0.5) / image.shape[0]
    rays = view.rays(u, v) @ view.eye[:3, :3].T
    true = view.eye[:3, 3] + rays * z[y, x][:, None]
    near = np.linalg.norm(true[:, None] - case.hands, axis=2).min(axis=1) < 0.05
    if not near.any():
        return float("nan")
    columns, rows, depth = points
    (i, s), (j, t) = _between(columns, u[near]), _between(rows, v[near])
    d = 1 / depth
    inverse = (d[j - 1, i - 1] * (1 - s) + d[j - 1, i] * s) * (1 - t) + (d[j, i - 1] * (1 - s) + d[j, i] * s) * t
    a, b = view.eye[:3, 3] + rays[near] / inverse[:, None] - eye[:3, 3], true[near] - eye[:3, 3]
    return float(np.median(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))))


def _between(points: F64, at: F64) -> tuple[NDArray[np.intp], F64]:
    i = np.minimum(np.searchsorted(points, at, "right"), len(points) - 1)
    return i, np.clip((at - points[i - 1]) / (points[i] - points[i - 1]), 0, 1)


def shape(view: View) -> tuple[int, int]:
    """The page's sizes: upright, square or lying."""
    aspect = (view.right - view.left) / (view.up - view.down)
    best = min((0.5, 1.0, 2.0), key=lambda one: abs(np.log(aspect / one)))
    return 16 * round(SIDE * best**0.5 / 16), 16 * round(SIDE / best**0.5 / 16)


def seen_size(view: View) -> tuple[int, int]:
    """Pixels of the truth."""
    return round((view.right - view.left) * DENSITY), round((view.up - view.down) * DENSITY)


def tracked(avatar: Avatar, *where: tuple[float, ...]) -> Pose:
    """How a user stands whose head and wrists have been there for a while."""
    tracker = Tracker(avatar.skeleton)
    head, left, right = (device(*one) for one in where)
    return [tracker.update(Sample(i / 72, head, left, right)) for i in range(90)][-1]


def joints_of(avatar: Avatar, pose: Pose) -> tuple[F64, F64]:
    """All, and those of the hands."""
    frames = avatar.skeleton.forward(pose.rotations, pose.trans, pose.translations)[:, :3, 3]
    words = ("wrist", "index", "middle", "ring", "pinky", "thumb")
    return frames, frames[[i for i, name in enumerate(avatar.skeleton.names) if any(word in name for word in words)]]


def still(avatar: Avatar) -> Iterator[Case]:
    """Before a mirror 1.2 m away with hands held out, one's own body with them before the chest, a room of three."""
    reflect = np.diag([-1.0, 1, 1, 1])
    pose = tracked(avatar, (0, 1.68, 0, 0, -10), (-0.2, 1.25, -0.45, 0, 10), (0.25, 1.35, -0.5, 0, 20))
    joints, hands = joints_of(avatar, pose)
    mirrored = np.diag([1.0, 1, -1, 1]) @ turned(0, 1.68, 2.4, 0, -10) @ reflect
    with Renderer(avatar) as renderer:
        yield Case("mirror", renderer, pose, mirrored, box_of(joints), hands)
    head = 0, 1.68, 0, 0, -42
    pose = tracked(avatar, head, (-0.2, 1.2, -0.38, 0, 15), (0.22, 1.25, -0.4, 0, 25))
    joints, hands = joints_of(avatar, pose)
    with Renderer(avatar.without("head")) as renderer:
        yield Case("own body", renderer, pose, turned(*head), box_of(joints), hands)
    others = [person(name) for name in PEOPLE]
    places = (((-0.35, 1.0), 180, "wave-and-turn"), ((0.15, 2.2), 200, "idle"), ((0.6, 4.0), 180, "wave-and-turn"))
    items, boxes, waving = [], [], None
    for one, ((x, z), yaw, motion) in zip(others, places, strict=True):
        posed, place = load_embedded_motion(motion, one.skeleton).at(1.1), turned(x, 0, z, yaw)
        items.append(Item(one, pose=posed, transform=place))
        joints, hands = (part @ place[:3, :3].T + place[:3, 3] for part in joints_of(one, posed))
        boxes.append(box_of(joints))
        waving = hands if waving is None else waving
    assert waving is not None
    with Renderer(Scene(items)) as renderer:
        yield Case("room, 1 to 4 m", renderer, None, turned(0, 1.65, 0, 180, -8), np.concatenate(boxes), waving, True)


def moved(eye: F64, aside: float, ahead: float, yaw: float) -> F64:
    """Along the eye's own x and the level direction that it looks in, then turned about the vertical."""
    out, forth = eye.copy(), -eye[:3, 2] * (1, 0, 1)
    out[:3, 3] += eye[:3, 0] * aside + forth / np.linalg.norm(forth) * ahead
    out[:3, :3] = turned(0, 0, 0, yaw)[:3, :3] @ eye[:3, :3]
    return out


def of_still(avatar: Avatar, warp: Warper, judge: Judge, save: Path | None) -> Iterator[str]:
    """Rows: nothing moves but the eye."""
    for case in still(avatar):
        view = framed(case.eye, case.box)
        image, z, found = ways(case, view, shape(view))
        for name, how in MOVES.items():
            seen = framed(moved(case.eye, *how), case.box, 0.05)
            size = seen_size(seen)
            case.renderer.resize(*size)
            truth = case.renderer.render([seen.camera(*size)], case.pose)[0].copy()
            _write(save, case.name, name, "truth", truth)
            for way, points in found.items():
                shown = warp(image, view, points, seen, size)
                _write(save, case.name, name, way, shown)
                quality, distance, holes, more = judge(shown, truth)
                angle = off(case, view, image, z, points, seen.eye)
                yield (
                    f"| {case.name} | {name} | {way} | {quality:.1f} | {distance:.3f} | {angle:.2f} "
                    f"| {100 * holes:.1f} | {100 * more:.1f} |"
                )


def of_moving(avatar: Avatar, warp: Warper, judge: Judge) -> Iterator[str]:
    """Rows: the embedded recording, body and head, 0.1 s late."""
    samples, tracker = embedded_recording(), Tracker(avatar.skeleton)
    poses = [tracker.update(sample) for sample in samples]
    heads = [head_matrix(one.head[:3], one.head[3:]) for one in samples if one.head is not None]
    for name, shown, seen_by in _views(avatar):
        with Renderer(shown) as renderer:
            rows: dict[str, list[tuple[float, float]]] = {}
            for first in range(43, len(heads) - LATE, 65):
                late = first + LATE
                joints, hands = joints_of(avatar, poses[first])
                case = Case(name, renderer, poses[first], seen_by(heads[first], heads[first]), box_of(joints), hands)
                view, seen = (framed(seen_by(heads[i], heads[first]), case.box, 0.05) for i in (first, late))
                image, _, found = ways(case, view, shape(view))
                if not image[..., 3].any():
                    continue
                size = seen_size(seen)
                renderer.resize(*size)
                truth = renderer.render([seen.camera(*size)], poses[late])[0].copy()
                for way, points in found.items():
                    rows.setdefault(way, []).append(judge(warp(image, view, points, seen, size), truth)[:2])
        for way, one in rows.items():
            quality, distance = np.mean(one, axis=0)
            yield f"| {name} | {way} | {quality:.1f} | {distance:.3f} |"


def _views(avatar: Avatar) -> Iterator[tuple[str, Avatar, Callable[[F64, F64], F64]]]:
    def mirrored(head: F64, first: F64) -> F64:
        ahead = -first[:3, 2] * (1, 0, 1) / np.linalg.norm(first[[0, 2], 2])
        reflection = np.eye(4)
        reflection[:3, :3] -= 2 * np.outer(ahead, ahead)
        reflection[:3, 3] = 2 * ahead * (first[:3, 3] @ ahead + 1.2)
        return np.asarray(reflection @ head @ np.diag([-1.0, 1, 1, 1]))

    yield "mirror", avatar, mirrored
    yield "own body", avatar.without("head"), lambda head, _: head @ turned(0, 0, 0, 0, -45)


def _write(folder: Path | None, *words: Any) -> None:
    if folder is not None:
        *name, image = words
        path = folder / ("-".join(map(str, name)).replace(" ", "-").replace(",", "") + ".png")
        cv2.imwrite(str(path), image[..., 2::-1])


def markdown(avatar: Avatar, save: Path | None = None) -> Iterator[str]:
    """Both tables, line by line."""
    warp, judge = Warper(), Judge()
    yield "| seen | the head | on a | PSNR, dB | LPIPS | hands off, degrees | holes, % | too much, % |"
    yield "|---|---|---|--:|--:|--:|--:|--:|"
    yield from of_still(avatar, warp, judge, save)
    yield from ("", "| seen, 0.1 s late | on a | PSNR, dB | LPIPS |", "|---|---|--:|--:|")
    yield from of_moving(avatar, warp, judge)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--person", default="ben", choices=PEOPLE)
    parser.add_argument("--save", type=Path, help="folder for the pictures")
    args = parser.parse_args()
    for line in markdown(person(args.person), args.save):
        print(line, flush=True)
